"""A delta action model: a residual policy that makes the simulator follow logged trajectories (after ASAP).

ASAP (He et al., RSS 2025, arXiv:2502.01143) trains by reinforcement learning a policy `delta(s, a)` that is added to
logged actions in the simulator, whose states are to follow the logged ones; then the task's policy is trained in the
simulator with the frozen `delta`. There PPO learns from the rewards of motion tracking; here SAC does, from one reward:

    r = exp(-e) - penalty mean_j (delta_j / scale_j)^2,     e^2 = mean_i ((s_i - s*_i) / sigma_i)^2

with s* the logged state, and sigma_i the standard deviation of the change of observation i over the log. e and not its
square, so that a small error is still worth removing.

Shapes: `O` observation, `A` action size.
"""

from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from envs import Environment, State, Wrapper
from mpge_jax.learning import sac
from mpge_jax.learning.sac import Actor
from mpge_jax.rollouts.trajectories import Trajectories


class Resettable(Environment, Protocol):
    """A simulator that can be put into a logged state."""

    def state_from_obs(self, obs: jax.Array) -> State: ...

    def tells_state(self, obs: jax.Array) -> jax.Array: ...


@dataclass(frozen=True)
class DeltaConfig:
    """How trajectories are followed.

    Attributes:
      horizon: steps of an episode, which begins in a random logged state.
      lost: an episode ends where the error e passes this.
      penalty: weight of the size of `delta`.
      reach: the largest `delta`, in widths of the simulator's box: with 1 any action can be made of any other.

    Raises:
      ValueError: a value out of its range.
    """

    horizon: int = 16
    lost: float = 2.0
    penalty: float = 0.01
    reach: float = 1.0

    def __post_init__(self) -> None:
        if self.horizon < 1:
            raise ValueError(f"horizon must be at least 1, got {self.horizon}")
        if not self.lost > 0 or self.penalty < 0:
            raise ValueError(
                f"lost must be above 0 and penalty at least 0, got {self.lost} and {self.penalty}"
            )
        if not self.reach > 0:
            raise ValueError(f"reach must be above 0, got {self.reach}")


class TrackingEnv:
    """The environment in which `delta` is learned: observations `(s, a)`, actions `delta`, reward for following.

    Args:
      env: the simulator.
      rows: what is to be followed.
      config: how.
    """

    def __init__(self, env: Resettable, rows: Trajectories, config: DeltaConfig):
        self._env, self._rows, self._config = env, rows, config
        self.name = f"{env.name} following a log"
        self.observation_size = env.observation_size + env.action_size
        self.action_size = env.action_size
        self.action_high = config.reach * (np.asarray(env.action_high) - np.asarray(env.action_low))
        self.action_low = -self.action_high
        self.max_steps = config.horizon
        logged = jnp.arange(rows.observation.shape[0]) < rows.count
        told = logged & jax.vmap(env.tells_state)(rows.observation)
        self._starts, self._start_count = jnp.argsort(~told, stable=True), jnp.sum(told)

    def reset(self, key: jax.Array) -> State:
        """In a random logged state, of those that an observation tells, or the first where there is none. `key` is
        consumed."""
        row = self._starts[jax.random.randint(key, (), 0, self._start_count)]
        inner = self._env.state_from_obs(self._rows.observation[row])
        zero = jnp.zeros((), inner.obs.dtype)
        obs = jnp.concatenate([inner.obs, self._rows.action[row]])
        steps = jnp.zeros((), jnp.int32)
        info = {"terminated": zero, "truncated": zero, "steps": steps, "next_obs": obs, "row": row}
        return State(inner, obs, zero, zero, {}, info)

    def step(self, state: State, action: jax.Array) -> State:
        """Plays the logged action plus `action [A]`, clipped to the simulator's box.

        Where the horizon ends, the episode is truncated; where it loses track, or the logged episode ends, terminated:
        nothing logged follows, that a value could be of.
        """
        rows, row = self._rows, state.info["row"]
        logged = rows.action[row]
        low, high = jnp.asarray(self._env.action_low), jnp.asarray(self._env.action_high)
        inner = self._env.step(state.data, jnp.clip(logged + action, low, high))
        reached = inner.info["next_obs"]
        error = jnp.sqrt(jnp.mean(jnp.square((reached - rows.following[row]) / rows.scale)))
        size = jnp.mean(jnp.square(action / jnp.asarray(self.action_high)))
        kind = reached.dtype
        lost = ~(error < self._config.lost)
        reward = jnp.where(lost, 0.0, jnp.exp(-error)) - self._config.penalty * size
        steps = state.info["steps"] + 1
        over = lost | rows.last[row]
        following = jnp.where(rows.last[row], row, row + 1)
        obs = jnp.concatenate([reached, rows.action[following]])
        terminated, truncated = over.astype(kind), (~over & (steps >= self.max_steps)).astype(kind)
        info = {
            "terminated": terminated,
            "truncated": truncated,
            "steps": steps,
            "next_obs": obs,
            "row": following,
        }
        return State(inner, obs, reward.astype(kind), jnp.maximum(terminated, truncated), {}, info)


def delta(actor: Actor, obs: Float[Array, "*n O"], action: Float[Array, "*n A"]) -> Float[Array, "*n A"]:
    """What the model adds to `action` at `obs`: the mode of its policy."""
    return sac.act(actor, jnp.concatenate([obs, action], axis=-1))


def executed(
    actor: Actor,
    obs: Float[Array, "*n O"],
    action: Float[Array, "*n A"],
    low: Float[Array, " A"],
    high: Float[Array, " A"],
) -> Float[Array, "*n A"]:
    """What the simulator is told where `action` is asked for, within its box."""
    low, high = (jnp.broadcast_to(end, action.shape) for end in (low, high))
    asked = jnp.clip(action, low, high)
    return jnp.clip(asked + delta(actor, obs, asked), low, high)


class DeltaEnv(Wrapper):
    """A simulator whose actions pass through a delta action model; the reward is that of the action asked for.

    Args:
      env: the simulator.
      actor: the model.
    """

    def __init__(self, env: Environment, actor: Actor):
        super().__init__(env)
        self._actor = actor

    def step(self, state: State, action: jax.Array) -> State:
        """One step of the simulator under `action + delta`, clipped."""
        low, high = jnp.asarray(self._env.action_low), jnp.asarray(self._env.action_high)
        given = executed(self._actor, state.obs, action, low, high)
        return self._env.step(state, given, charged=action)  # type: ignore[call-arg]
