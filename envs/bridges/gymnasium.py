"""Environments as `gymnasium.Env`, for trainers that step one simulation at a time."""

from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np

from envs.types import State
from envs.wrappers import Environment


class GymnasiumBridge(gymnasium.Env[np.ndarray, np.ndarray]):
    """An environment of this project with Gymnasium's interface.

    `terminated` is the task's, `truncated` the time limit `max_steps`, so that no `TimeLimit` is wanted around it.
    `info` holds the parts of the reward. The seed of `reset` decides all that is random, in later episodes too.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, env: Environment):
        self.observation_space, self.action_space = spaces(env)
        self._advance = jax.jit(env.step)
        self._begin = jax.jit(lambda key: begin(env, key))
        self._key: jax.Array | None = None
        self._state: State | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """The first observation `[O]` of an episode, and an empty info."""
        super().reset(seed=seed, options=options)
        if seed is not None or self._key is None:
            self._key = key_of(self.np_random)
        self._key, self._state = self._begin(self._key)
        return np.array(self._state.obs), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Observation `[O]`, reward, terminated, truncated and info after `action [A]`.

        Raises:
          ResetNeeded: there is no episode yet.
          ValueError: an action of another shape.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() before the first step()")
        self._state = self._advance(self._state, jnp.asarray(action, self._state.obs.dtype))
        obs, reward, info, metrics = jax.device_get(
            (self._state.obs, self._state.reward, self._state.info, self._state.metrics)
        )
        ended = bool(info["terminated"]), bool(info["truncated"])
        return np.array(obs), float(reward), *ended, {name: float(x) for name, x in metrics.items()}


def spaces(env: Environment) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """The spaces of observations, `[O]` without bounds, and of actions, the action box `[A]`."""
    observations = gymnasium.spaces.Box(
        -np.inf, np.inf, (env.observation_size,), np.dtype(jnp.result_type(float))
    )
    return observations, gymnasium.spaces.Box(env.action_low, env.action_high, dtype=np.float32)


def key_of(random: np.random.Generator) -> jax.Array:
    """A key that a NumPy generator decides."""
    return jax.random.key(int(random.integers(2**31)))


def begin(env: Environment, key: jax.Array) -> tuple[jax.Array, State]:
    """A key for later episodes, and the first state of this one. `key` is consumed."""
    key, key_reset = jax.random.split(key)
    return key, env.reset(key_reset)
