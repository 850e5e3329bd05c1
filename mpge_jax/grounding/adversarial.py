"""Grounding: an action transformer learned by adversarial imitation from observation (MPGE, Algorithm 1).

Rollout policies act in the simulator through pi_g(delta | s, a); a discriminator D(s, a, s') shared by all of them
tells these transitions from the target's, which is equation (2) of Lee et al. (IJCAI 2022); pi_g follows the reward
-log D, whose mean over the K policies is their equation (3), by TRPO or PPO, with gamma = 0, so that the advantage is
r - V_k(s, a), or, where several draws branch off from one state, r less the mean reward of the others.

`init` and `update` are pure. Train N transformers, each with its own log, policies and key, by `jax.vmap` over both.

Shapes: `B` parallel environments, `T` steps an iteration, `J` branches, `K` rollout policies, `O` observation, `A`
action size.
"""

import types
from functools import partial

import flax.struct
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key, PRNGKeyArray

from envs import Env, State
from mpge_jax.grounding import collect, discriminator, transformer
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.discriminator import DiscriminatorState, Transitions
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.learning import ppo, trpo, value
from mpge_jax.learning.policy_gradient import Metrics, Params, PolicyBatch
from mpge_jax.learning.ppo import PPOState
from mpge_jax.learning.trpo import TRPOConfig, TRPOState
from mpge_jax.learning.value import ValueState
from mpge_jax.rollouts.rollout import RolloutPolicies
from mpge_jax.rollouts.target_log import TargetLog


class GroundingState(flax.struct.PyTreeNode):
    """Everything that learning one transformer needs to go on.

    Attributes:
      transformer: pi_g; its parameters live in `policy`, see `current`.
      policy: state of TRPO or PPO.
      average: running average of pi_g's parameters.
      value: the K value functions.
      discriminator: D.
      env_state: of B simulators.
      rollout_policy: which policy acts in each.
      starts: rows of the log that episodes may begin in, where they begin in logged ones.
      expected: next observations of the untouched simulator from the logged (s, a), where D wants them.
      key: for all later draws.
    """

    transformer: Transformer
    policy: TRPOState | PPOState
    average: Params
    value: ValueState
    discriminator: DiscriminatorState
    env_state: State
    rollout_policy: Int[Array, "*n B"]
    starts: TargetLog | None
    expected: Float[Array, "*n K M O"] | None
    key: Key[Array, "*n"]

    @property
    def current(self) -> Transformer:
        """The transformer with its newest parameters, which collects."""
        return self.transformer.replace(params=self.policy.params)

    @property
    def result(self) -> Transformer:
        """The transformer that has been learned: the running average."""
        return self.transformer.replace(params=self.average)


def _algorithm(config: GroundingConfig) -> types.ModuleType:
    return trpo if isinstance(config.policy, TRPOConfig) else ppo


def init(
    key: PRNGKeyArray,
    env: Env,
    policies: RolloutPolicies,
    log: TargetLog,
    config: GroundingConfig,
    start: Transformer | None = None,
) -> GroundingState:
    """A fresh transformer (or one that goes on from `start`), D, values and simulators. `key` is consumed.

    Args:
      env: the simulator, without auto-reset.
      policies: the K rollout policies.
      log: transitions of the same K policies in the target.
    """
    size = log.count.shape[0]
    if policies.size != size:
        raise ValueError(
            f"the target log is of {size} rollout policies, but {policies.size} policies were given"
        )
    key_policy, key_value, key_discriminator, key_start, key = jax.random.split(key, 5)
    pi_g = start
    if pi_g is None:
        pi_g = transformer.init(key_policy, env.observation_size, env.action_size, config.transformer)
    starts = collect.starts_of(env, log, config)
    begun = jax.vmap(lambda k: collect.start(k, env, starts, config))(
        jax.random.split(key_start, config.num_envs)
    )
    return GroundingState(
        transformer=pi_g,
        policy=_algorithm(config).init(pi_g.params, config.policy),
        average=jax.tree.map(jnp.copy, pi_g.params),
        value=value.init(key_value, env.observation_size + env.action_size, config.value(size)),
        discriminator=discriminator.init(
            key_discriminator, env.observation_size, env.action_size, config.discriminator
        ),
        env_state=begun[0],
        rollout_policy=begun[1],
        starts=starts if config.restart_steps else None,
        expected=jax.vmap(partial(collect.expected_next, env))(log.observation, log.action)
        if config.needs_expected
        else None,
        key=key,
    )


def update(
    state: GroundingState, env: Env, policies: RolloutPolicies, log: TargetLog, config: GroundingConfig
) -> tuple[GroundingState, Metrics]:
    """One outer iteration: collect B * T steps, then update D, pi_g and the values. Arguments as in `init`.

    Returns:
      The next state and metrics, each `[]`: those of D, of the policy update and of the values, the mean `reward`,
      and the mean `log_std` of pi_g.
    """
    key_collect, key_d, key_policy, key_value, key = jax.random.split(state.key, 5)
    begun, starts = (state.env_state, state.rollout_policy), log if state.starts is None else state.starts
    (env_state, rollout_policy), rows = collect.collect(
        key_collect, state.current, begun, env, policies, starts, config
    )
    grounded = rows.transitions
    learned, d_metrics = update_discriminator(
        key_d, state.discriminator, grounded, rows.rollout_policy, log, state.expected, config
    )
    judge = learned if config.discriminator_first else state.discriminator
    rewards = discriminator.reward(judge, grounded, config.discriminator)

    inputs = transformer.network_inputs(state.transformer, rows.observation, rows.action)
    # Equation (3) is followed along r = -log D less a baseline. gamma = 0: the return is the reward.
    if config.branches > 1:
        heads, value_metrics = state.value, Metrics()
        advantages = _less_siblings(rewards, config)
    else:
        value_config = config.value(log.count.shape[0])
        advantages = rewards - value.predict(state.value.params, inputs, rows.rollout_policy, value_config)
        heads, value_metrics = value.update(
            state.value, inputs, rows.rollout_policy, rewards, key_value, value_config
        )
    batch = PolicyBatch(inputs, rows.delta, rows.log_prob, advantages)
    policy, policy_metrics = _algorithm(config).update(
        state.policy, batch, key_policy, transformer.apply, config.policy
    )
    decay = config.averaging
    state = state.replace(
        policy=policy,
        average=jax.tree.map(lambda a, p: decay * a + (1.0 - decay) * p, state.average, policy.params),
        value=heads,
        discriminator=learned,
        env_state=env_state,
        rollout_policy=rollout_policy,
        key=key,
    )
    metrics = {f"d_{name}": x for name, x in d_metrics.items()}
    metrics |= {f"policy_{name}": x for name, x in policy_metrics.items()}
    metrics |= value_metrics
    metrics |= {"reward": jnp.mean(rewards), "log_std": jnp.mean(policy.params["log_std"])}
    return state, metrics


def _less_siblings(rewards: Float[Array, " R"], config: GroundingConfig) -> Float[Array, " R"]:
    """Rewards, R = T * J * B, less the mean of the other draws at the same state."""
    of_state = rewards.reshape(config.steps_per_iteration, config.branches, config.num_envs)
    others = (jnp.sum(of_state, axis=1, keepdims=True) - of_state) / (config.branches - 1)
    return (of_state - others).reshape(-1)


def update_discriminator(
    key: PRNGKeyArray,
    state: DiscriminatorState,
    grounded: Transitions,
    which: Int[Array, " R"],
    log: TargetLog,
    expected: Float[Array, "K M O"] | None,
    config: GroundingConfig,
) -> tuple[DiscriminatorState, Metrics]:
    """The updates of D in one iteration, each on as many grounded rows as rows of the target.

    Args:
      grounded: R rows that were collected. which: the rollout policy of each.
      log: of the target. expected: what the simulator itself would have done there, where D sees s' less that.
    """
    count = config.discriminator_batch

    def step(state: DiscriminatorState, key: PRNGKeyArray) -> tuple[DiscriminatorState, Metrics]:
        key_grounded, key_target, key_update = jax.random.split(key, 3)
        rows = jax.random.randint(key_grounded, (count,), 0, which.shape[0])
        # As many target rows of a policy as grounded rows of it, with replacement, as the authors' release has it.
        of = which[rows]
        at = jax.random.randint(key_target, (count,), 0, log.count[of])
        every = Transitions(log.observation, log.action, log.next_observation, expected)
        target = jax.tree.map(lambda x: x[of, at], every)
        chosen = jax.tree.map(lambda x: x[rows], grounded)
        return discriminator.update(state, chosen, target, key_update, config.discriminator)

    state, metrics = jax.lax.scan(step, state, jax.random.split(key, config.discriminator_updates))
    return state, jax.tree.map(lambda x: x[-1], metrics)
