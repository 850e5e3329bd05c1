"""Environments with gymnax's interface, for trainers written against it; gymnax itself is not needed."""

from dataclasses import dataclass
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp

from envs.select import select
from envs.types import State
from envs.wrappers import Environment

Stepped = tuple[jax.Array, State, jax.Array, jax.Array, dict[str, Any]]


@flax.struct.dataclass
class EnvParams:
    """What a caller may change: `max_steps_in_episode` cuts episodes shorter than the environment itself does."""

    max_steps_in_episode: int


@dataclass(frozen=True)
class Box:
    """Arrays of one shape between `low` and `high`, which have that shape too; attributes as gymnax's."""

    low: jax.Array
    high: jax.Array
    shape: tuple[int, ...]
    dtype: Any

    def sample(self, key: jax.Array) -> jax.Array:
        """Uniform between the bounds, which must be finite. `key` is consumed."""
        return jax.random.uniform(key, self.shape, self.dtype, self.low, self.high)

    def contains(self, x: jax.Array) -> jax.Array:
        """Whether `x` lies between the bounds, `[]`."""
        return jnp.all((x >= self.low) & (x <= self.high))


class GymnaxBridge:
    """An environment of this project with gymnax's interface; its state is a `State`.

    `step` resets where an episode ended, as gymnax does, so its observation is then the next episode's first. `done` is
    termination or the time limit; `info` has both apart as `terminated` and `truncated`, bool, with `discount` (0 where
    terminated), `next_obs` (the observation that the step truly led to: what a trainer bootstraps from where an episode
    was cut), and the environment's metrics.
    """

    def __init__(self, env: Environment):
        self._env = env
        self.name = env.name
        self.num_actions = env.action_size

    @property
    def default_params(self) -> EnvParams:
        return EnvParams(self._env.max_steps)

    def reset(self, key: jax.Array, params: EnvParams | None = None) -> tuple[jax.Array, State]:
        """The first observation `[O]` and state of an episode. `key` is consumed."""
        del params
        state = self._env.reset(key)
        return state.obs, state

    def step(
        self, key: jax.Array, state: State, action: jax.Array, params: EnvParams | None = None
    ) -> Stepped:
        """Observation `[O]`, state, reward, done and info after `action [A]`; resets at the end of an episode."""
        obs, after, reward, done, info = self.step_env(key, state, action, params)
        obs, after = select(done, self.reset(key, params), (obs, after))
        return obs, after, reward, done, info

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: EnvParams | None = None
    ) -> Stepped:
        """`step` without the reset."""
        del key
        limit = (params or self.default_params).max_steps_in_episode
        # Where there is one action, gymnax's own tasks take a scalar, and rejax's trainers give one.
        after = self._env.step(state, jnp.atleast_1d(action))
        terminated = after.info["terminated"] > 0
        truncated = (after.info["truncated"] > 0) | (after.info["steps"] >= limit)
        info = {
            **after.metrics,
            "terminated": terminated,
            "truncated": truncated,
            "discount": 1 - after.info["terminated"],
            "next_obs": after.info["next_obs"],
        }
        return after.obs, after, after.reward, terminated | truncated, info

    def get_obs(
        self, state: State, params: EnvParams | None = None, key: jax.Array | None = None
    ) -> jax.Array:
        """The observation `[O]` of a state."""
        del params, key
        return state.obs

    def observation_space(self, params: EnvParams | None = None) -> Box:
        """Unbounded, `[O]`."""
        del params
        dtype = jnp.result_type(float)
        bound = jnp.full(self._env.observation_size, jnp.inf, dtype)
        return Box(-bound, bound, bound.shape, dtype)

    def action_space(self, params: EnvParams | None = None) -> Box:
        """The action box, `[A]`."""
        del params
        low, high = jnp.asarray(self._env.action_low), jnp.asarray(self._env.action_high)
        return Box(low, high, low.shape, low.dtype)
