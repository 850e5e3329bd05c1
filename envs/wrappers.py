"""Wrappers with the interface of an environment."""

from typing import Any, Protocol

import jax
import numpy as np

from envs.select import finite_or, select
from envs.types import State


class Environment(Protocol):
    """What every environment and wrapper here offers."""

    name: str
    observation_size: int
    action_size: int
    action_low: np.ndarray
    action_high: np.ndarray
    max_steps: int

    def reset(self, key: jax.Array) -> State: ...

    def step(self, state: State, action: jax.Array) -> State: ...


class Wrapper:
    """An environment around another: the public attributes that it does not define are those of the wrapped one."""

    def __init__(self, env: Environment):
        self._env = env

    def __getattr__(self, name: str) -> Any:
        # Copying and unpickling ask for private attributes before there is an `_env`.
        if name.startswith("_"):
            raise AttributeError(
                f"{type(self).__name__!r} object has no attribute {name!r}", name=name, obj=self
            )
        return getattr(self._env, name)


class AutoReset(Wrapper):
    """Starts a fresh episode in the same call where one ends.

    `obs` is then the new episode's first observation; `info["next_obs"]` stays the observation that the step truly
    led to (the one before it where the simulation diverged, so that what is learned from stays finite), and
    `reward`, `done`, `metrics`, `info["terminated"]`, `info["truncated"]` stay those of that step.
    """

    def reset(self, key: jax.Array) -> State:
        """As the wrapped environment's; keeps a key for later resets in `info["key"]`. `key` is consumed."""
        key, key_reset = jax.random.split(key)
        state = self._env.reset(key_reset)
        return state.replace(info={**state.info, "key": key})

    def step(self, state: State, action: jax.Array) -> State:
        """One step, and a reset where it ended the episode."""
        info = dict(state.info)
        key, key_reset = jax.random.split(info.pop("key"))
        after = self._env.step(state.replace(info=info), action)
        first = self._env.reset(key_reset)
        kept = {name: after.info[name] for name in ("terminated", "truncated")}
        kept["next_obs"] = finite_or(after.info["next_obs"], state.obs)
        begun = (first.data, first.obs, first.info)
        data, obs, info = select(after.done > 0, begun, (after.data, after.obs, after.info))
        return after.replace(data=data, obs=obs, info={**info, **kept, "key": key})
