"""Probe environments: a few lines of algebra whose best policies and values are known.

They have the interface of `envs.Environment`, so whatever learns in MuJoCo learns here, in milliseconds. The
`data` of a state is its observation: these worlds have no other state.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs import State

Advance = Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array, jax.Array]]


@dataclass(frozen=True)
class Probe:
    """A world with the actions `[-limit, limit]^A`.

    Attributes:
      first: `key -> obs [O]`.
      advance: `(obs [O], action [A]) -> (next obs [O], reward [], terminated [])`.
    """

    name: str
    observation_size: int
    first: Callable[[jax.Array], jax.Array]
    advance: Advance
    action_size: int = 1
    limit: float = 1.0
    max_steps: int = 1

    @property
    def action_high(self) -> np.ndarray:
        return np.full(self.action_size, self.limit, np.float32)

    @property
    def action_low(self) -> np.ndarray:
        return -self.action_high

    def reset(self, key: jax.Array) -> State:
        return self.state_from_obs(self.first(key))

    def state_from_obs(self, obs: jax.Array) -> State:
        zero = jnp.zeros(())
        info = {"terminated": zero, "truncated": zero, "steps": jnp.zeros((), jnp.int32), "next_obs": obs}
        return State(data=obs, obs=obs, reward=zero, done=zero, metrics={}, info=info)

    def tells_state(self, obs: jax.Array) -> jax.Array:
        return jnp.ones((), bool)

    def predict(self, obs: jax.Array, action: jax.Array) -> jax.Array:
        return self.step(self.state_from_obs(obs), action).info["next_obs"]

    def step(self, state: State, action: jax.Array) -> State:
        obs, reward, terminated = self.advance(state.data, jnp.clip(action, -self.limit, self.limit))
        steps = state.info["steps"] + 1
        truncated = (steps >= self.max_steps).astype(jnp.float32)
        info = {
            **state.info,
            "terminated": terminated,
            "truncated": truncated,
            "steps": steps,
            "next_obs": obs,
        }
        return State(obs, obs, reward, jnp.maximum(terminated, truncated), {}, info)


def bandit(optimum: float = 0.3, limit: float = 1.0) -> Probe:
    """One step, reward `-(a - optimum)^2`. Best action: `optimum`, of value 0."""

    def advance(obs: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return obs, -jnp.square(action[0] - optimum), jnp.ones(())

    return Probe("Bandit", 1, lambda key: jnp.ones(1), advance, limit=limit)


def contextual_bandit(slope: float = 0.5) -> Probe:
    """One step from `s ~ U(-1, 1)`, reward `-(a - slope s)^2`. Best action: `slope s`, of value 0."""

    def advance(obs: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return obs, -jnp.square(action[0] - slope * obs[0]), jnp.ones(())

    return Probe("ContextualBandit", 1, lambda key: jax.random.uniform(key, (1,), minval=-1.0), advance)


def clock(terminates: bool) -> Probe:
    """One step of reward 1, whatever is done, back to where it began.

    Value: 1 where the step terminates; `1 / (1 - gamma)` where only the time limit ends the episode.
    """

    def advance(obs: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return obs, jnp.ones(()), jnp.full((), float(terminates))

    return Probe("Clock", 1, lambda key: jnp.ones(1), advance)


def delayed() -> Probe:
    """Two steps: the first action is remembered and paid for in the second.

    Observation `(step, remembered action)`. `Q((0, 0), a) = gamma a`, `Q((1, m), a) = m`. Best at first: 1.
    """

    def advance(obs: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return jnp.stack([jnp.ones(()), action[0]]), obs[0] * obs[1], obs[0]

    return Probe("Delayed", 2, lambda key: jnp.zeros(2), advance, max_steps=2)


def point(shift: float = 0.0, max_steps: int = 20) -> Probe:
    """`x' = 0.8 x + clip(a + shift, -1, 1)` from `x ~ U(-1, 1)`, reward `-x'^2`; never terminates.

    A source (`shift=0`) and its targets: the source moves as the target does under `a + shift`, clipped.
    """

    def advance(obs: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        x = 0.8 * obs + jnp.clip(action + shift, -1.0, 1.0)
        return x, -jnp.square(x[0]), jnp.zeros(())

    return Probe(
        "Point", 1, lambda key: jax.random.uniform(key, (1,), minval=-1.0), advance, max_steps=max_steps
    )
