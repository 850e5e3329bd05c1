"""An agent that learns by SAC in many copies of an environment: one compiled iteration collects, then updates.

Shapes: `E` parallel environments, `O` observation size, `A` action size.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, PRNGKeyArray

from envs import AutoReset, Environment, State, select
from mpge_jax.learning import buffer as replay
from mpge_jax.learning import sac
from mpge_jax.learning.policy_gradient import Metrics
from mpge_jax.learning.sac import Actor, SACConfig, SACState

RewardBonus = Callable[[Float[Array, " O"]], Float[Array, ""]]


@dataclass(frozen=True)
class AgentConfig:
    """How an agent collects and learns.

    Attributes:
      sac: the learner.
      num_envs: parallel environments, E.
      steps_per_iteration: steps of every environment in one compiled iteration.
      updates_per_iteration: SAC updates in one compiled iteration.
      alternations: in how many equal parts an iteration alternates between steps and updates; with as many as there
        are steps and updates, each step is followed by one update.
      buffer_capacity: transitions kept.
      random_steps: uniformly random steps (over all environments) before the policy acts and learning begins.
    """

    sac: SACConfig = field(default_factory=SACConfig)
    num_envs: int = 16
    steps_per_iteration: int = 64
    updates_per_iteration: int = 256
    alternations: int = 1
    buffer_capacity: int = 1_000_000
    random_steps: int = 10_000

    def __post_init__(self) -> None:
        for name in (
            "num_envs",
            "steps_per_iteration",
            "updates_per_iteration",
            "alternations",
            "random_steps",
        ):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}.")
        for name in ("steps_per_iteration", "updates_per_iteration"):
            if getattr(self, name) % self.alternations:
                raise ValueError(
                    f"{name} of {getattr(self, name)} cannot be divided into {self.alternations} alternations."
                )
        needed = max(self.random_rounds * self.num_envs, self.num_envs * self.steps_per_iteration)
        if self.buffer_capacity < needed:
            raise ValueError(
                f"buffer_capacity of {self.buffer_capacity} does not hold the {needed} transitions of one collection."
            )

    @property
    def random_rounds(self) -> int:
        """Rounds of all environments that make at least `random_steps`."""
        return -(-self.random_steps // self.num_envs)

    @property
    def env_steps_per_iteration(self) -> int:
        return self.num_envs * self.steps_per_iteration

    def env_steps(self, iterations: int) -> int:
        """Environment steps of a training of so many iterations, the random ones included."""
        return self.random_rounds * self.num_envs + iterations * self.env_steps_per_iteration


class AgentState(flax.struct.PyTreeNode):
    """Everything that an interrupted training needs to go on."""

    learner: SACState
    buffer: replay.ReplayBuffer
    env_state: State
    episode_return: Float[Array, "*n E"]
    last_return: Float[Array, "*n E"]
    key: Key[Array, "*n"]


def init(
    key: PRNGKeyArray,
    env: Environment,
    config: AgentConfig,
    learner: SACState | None = None,
    bonus: RewardBonus | None = None,
    first: Literal["uniform", "policy"] = "uniform",
) -> AgentState:
    """A fresh agent (or one that goes on from `learner`) whose buffer holds `random_steps` transitions.

    `key` is consumed. `bonus` is as in `iterate`. `first`: whether uniformly random actions lead to them, or the
    policy's own.
    """
    key_learner, key_reset, key_random, key = jax.random.split(key, 4)
    if learner is None:
        ends = np.asarray(env.action_low), np.asarray(env.action_high)
        sizes = env.observation_size, env.action_size
        scale, middle = (ends[1] - ends[0]) / 2, (ends[1] + ends[0]) / 2
        learner = sac.init(key_learner, *sizes, scale, config.sac, middle)
    env_state = jax.vmap(AutoReset(env).reset)(jax.random.split(key_reset, config.num_envs))
    zeros = jnp.zeros(config.num_envs)
    state = AgentState(
        learner=learner,
        buffer=replay.init(config.buffer_capacity, env.observation_size, env.action_size),
        env_state=env_state,
        episode_return=zeros,
        last_return=jnp.full(config.num_envs, jnp.nan, jnp.float32),
        key=key,
    )
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)

    def first_action(obs: Float[Array, "E O"], key: PRNGKeyArray) -> Float[Array, "E A"]:
        if first == "policy":
            return sac.act(state.learner.actor, obs, key)
        return jax.random.uniform(key, (obs.shape[0], env.action_size), obs.dtype, low, high)

    return collect(state, env, first_action, key_random, config.random_rounds, bonus)


def iterate(
    state: AgentState, env: Environment, config: AgentConfig, bonus: RewardBonus | None = None
) -> tuple[AgentState, Metrics]:
    """One iteration: `steps_per_iteration` in each environment and `updates_per_iteration` SAC updates.

    Args:
      state: where training stands.
      env: what to act in, without auto-reset.
      config: as given to `init`.
      bonus: `obs [O] -> []`, added to the reward of acting at `obs`.

    Returns:
      The next state and metrics: SAC's own, and `return`, the mean return (bonus excluded) of every environment's last
      finished episode, NaN before the first.
    """
    steps = config.steps_per_iteration // config.alternations
    updates = config.updates_per_iteration // config.alternations

    def alternate(state: AgentState, _: None) -> tuple[AgentState, Metrics]:
        key, key_act, key_update = jax.random.split(state.key, 3)

        def policy(obs: Float[Array, "E O"], key: PRNGKeyArray) -> Float[Array, "E A"]:
            return sac.act(state.learner.actor, obs, key)

        state = collect(state.replace(key=key), env, policy, key_act, steps, bonus)
        learner, metrics = sac.update_many(state.learner, state.buffer, key_update, updates, config.sac)
        return state.replace(learner=learner), metrics

    state, metrics = jax.lax.scan(alternate, state, None, config.alternations)
    metrics = jax.tree.map(lambda x: jnp.mean(x, axis=0), metrics)
    return state, {**metrics, "return": jnp.nanmean(state.last_return)}


def collect(
    state: AgentState,
    env: Environment,
    policy: Callable[[Float[Array, "E O"], PRNGKeyArray], Float[Array, "E A"]],
    key: PRNGKeyArray,
    steps: int,
    bonus: RewardBonus | None,
) -> AgentState:
    """Takes `steps` in each environment as `policy` says, and puts them into the buffer. `key` is consumed."""
    stepper = jax.vmap(AutoReset(env).step)

    def body(
        carry: tuple[State, Float[Array, " E"], Float[Array, " E"]], key: PRNGKeyArray
    ) -> tuple[Any, replay.Transition]:
        env_state, episode_return, last_return = carry
        obs = env_state.obs
        action = policy(obs, key)
        after = stepper(env_state, action)
        reward = after.reward if bonus is None else after.reward + jax.vmap(bonus)(obs)
        transition = replay.Transition(obs, action, reward, after.info["next_obs"], after.info["terminated"])
        episode_return = episode_return + after.reward
        last_return = jnp.where(after.done > 0, episode_return, last_return)
        return (after, jnp.where(after.done > 0, 0.0, episode_return), last_return), transition

    carry = (state.env_state, state.episode_return, state.last_return)
    carry, transitions = jax.lax.scan(body, carry, jax.random.split(key, steps))
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), transitions)
    return state.replace(
        env_state=carry[0],
        episode_return=carry[1],
        last_return=carry[2],
        buffer=replay.add_batch(state.buffer, flat),
    )


def evaluate(
    key: PRNGKeyArray,
    env: Environment,
    actor: Actor,
    episodes: int = 50,
    stochastic: bool = False,
) -> Float[Array, " episodes"]:
    """Undiscounted returns of whole episodes in `env`. `key` is consumed."""
    key_reset, key_act = jax.random.split(key)
    first = jax.vmap(env.reset)(jax.random.split(key_reset, episodes))

    def body(
        carry: tuple[State, Float[Array, " E"], Float[Array, " E"]], key: PRNGKeyArray
    ) -> tuple[Any, None]:
        env_state, total, alive = carry
        action = sac.act(actor, env_state.obs, key if stochastic else None)
        after = jax.vmap(env.step)(env_state, action)
        total = total + jnp.where(alive > 0, after.reward, 0.0)
        # Episodes that are over stay where they ended, so that no diverging state reaches the engine.
        ended = alive * after.done
        keep = alive > 0
        return (select(keep, after, env_state), total, alive - ended), None

    carry = (first, jnp.zeros(episodes), jnp.ones(episodes))
    (_, total, _), _ = jax.lax.scan(body, carry, jax.random.split(key_act, env.max_steps))
    return total
