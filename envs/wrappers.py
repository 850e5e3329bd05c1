"""Wrappers with the interface of an environment."""

from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

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


class AutoReset:
    """Starts a fresh episode in the same call where one ends.

    `obs` is then the new episode's first observation; `info["next_obs"]` stays the observation that the step truly led
    to, and `reward`, `done`, `metrics`, `info["terminated"]`, `info["truncated"]` stay those of that step.
    """

    def __init__(self, env: Environment):
        self._env = env

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

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
        ended = after.done > 0
        pick = lambda new, old: jnp.where(ended, new, old)  # noqa: E731
        kept = {name: after.info[name] for name in ("terminated", "truncated", "next_obs")}
        return after.replace(
            data=_pick_data(pick, first.data, after.data),
            obs=pick(first.obs, after.obs),
            info={**jax.tree.map(pick, first.info, after.info), **kept, "key": key},
        )


def _pick_data(pick: Callable[[jax.Array, jax.Array], jax.Array], first: Any, after: Any) -> Any:
    if not hasattr(after, "_impl"):
        return jax.tree.map(pick, first, after)
    # MJX's `_impl` is scratch space, computed anew by every step; Warp's is shared by all copies and cannot be picked.
    public = jax.tree.map(pick, first.replace(_impl=None), after.replace(_impl=None))
    return public.replace(_impl=after._impl)
