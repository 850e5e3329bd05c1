"""Grounding: an action transformer learned by adversarial imitation from observation (MPGE, Algorithm 1).

Rollout policies act in the simulator through pi_g(delta | s, a); a discriminator D(s, a, s') shared by all of them
tells these transitions from the target's; pi_g follows the reward -log D by TRPO or PPO, with gamma = 0, so that the
advantage is r - V_k(s, a), or, where several draws branch off from one state, r less the mean reward of the others.

`init` and `update` are pure. Train N transformers, each with its own log, policies and key, by `jax.vmap` over both.

Shapes: `B` parallel environments, `T` steps an iteration, `J` branches, `K` rollout policies, `O` observation, `A`
action size.
"""

import types
from dataclasses import dataclass, field
from typing import Any, Literal

import flax.struct
import jax
import jax.numpy as jnp

from envs import Env, State
from mpge_jax import discriminator, ppo, sac, transformer, trpo, value
from mpge_jax.discriminator import DiscriminatorConfig, DiscriminatorState, Transitions
from mpge_jax.policy_gradient import Metrics, Params, PolicyBatch
from mpge_jax.ppo import PPOConfig, PPOState
from mpge_jax.sac import Actor, SACConfig
from mpge_jax.target_log import TargetLog
from mpge_jax.transformer import Transformer, TransformerConfig
from mpge_jax.trpo import TRPOConfig, TRPOState
from mpge_jax.value import ValueConfig, ValueState


@dataclass(frozen=True)
class GroundingConfig:
    """How a transformer is learned; the defaults are the paper's.

    Attributes:
      num_envs: parallel copies of the simulator, B.
      steps_per_iteration: steps of each in one iteration, T; B * T * J is the batch of one policy update.
      branches: draws of pi_g at every state, J; each is simulated one step and the first is followed. Beyond 1, the
        "vine" of TRPO (Schulman et al., 2015, section 5.2), exact here because gamma = 0: the baseline of a draw is
        the mean reward of its siblings, which no error of a value function blurs, and the values are not learned.
      iterations: outer iterations.
      transformer: the policy pi_g.
      policy: how it is updated.
      discriminator: D.
      discriminator_updates: gradient steps on D in one iteration.
      discriminator_batch: grounded rows, and as many target rows, of one such step.
      discriminator_first: D before pi_g (Algorithm 1), or after (the release, whose reward is older by one update).
      value_heads, value_learning_rate, value_epochs, value_minibatch: the K value functions.
      restart_steps: 0 starts episodes as the task does, and they last as long as the task lets them; a number starts
        them in states of the target log and ends them after so many steps (this project's addition).
      averaging: decay, an iteration, of the running average of pi_g's parameters that is the result; 0 takes the last
        iterate. A trust-region step has one length however small the gradient, so the iterates end in a random walk
        around the optimum, which the average does not.
      rollout: SAC configuration of the rollout policies (only their network matters here).
    """

    num_envs: int = 64
    steps_per_iteration: int = 32
    branches: int = 1
    iterations: int = 1000
    transformer: TransformerConfig = field(default_factory=TransformerConfig)
    policy: TRPOConfig | PPOConfig = field(default_factory=TRPOConfig)
    discriminator: DiscriminatorConfig = field(default_factory=DiscriminatorConfig)
    discriminator_updates: int = 8
    discriminator_batch: int = 256
    discriminator_first: bool = True
    value_heads: Literal["separate", "one_hot"] = "separate"
    value_learning_rate: float = 1e-3
    value_epochs: int = 5
    value_minibatch: int = 128
    restart_steps: int = 0
    averaging: float = 0.0
    rollout: SACConfig = field(default_factory=SACConfig)

    def __post_init__(self) -> None:
        names = (
            "num_envs",
            "steps_per_iteration",
            "branches",
            "iterations",
            "discriminator_updates",
            "discriminator_batch",
        )
        for name in names:
            if getattr(self, name) < 1:
                raise ValueError(f"GroundingConfig: {name} must be at least 1, got {getattr(self, name)}.")
        if self.restart_steps < 0:
            raise ValueError(
                f"GroundingConfig: restart_steps must not be negative, got {self.restart_steps}."
            )
        if not 0.0 <= self.averaging < 1.0:
            raise ValueError(f"GroundingConfig: averaging must lie in [0, 1), got {self.averaging}.")
        if self.value_minibatch > self.batch_size:
            raise ValueError(
                f"GroundingConfig: value_minibatch of {self.value_minibatch} exceeds the batch of {self.batch_size}."
            )

    @property
    def batch_size(self) -> int:
        """Environment steps of one iteration."""
        return self.num_envs * self.steps_per_iteration * self.branches

    def value(self, policies: int) -> ValueConfig:
        """Configuration of the value functions of `policies` rollout policies."""
        return ValueConfig(
            policies,
            heads=self.value_heads,
            learning_rate=self.value_learning_rate,
            epochs=self.value_epochs,
            minibatch_size=self.value_minibatch,
        )


class GroundingState(flax.struct.PyTreeNode):
    """Everything that learning one transformer needs to go on.

    Attributes:
      transformer: pi_g; its parameters live in `policy`, see `current`.
      policy: state of TRPO or PPO.
      average: running average of pi_g's parameters.
      value: the K value functions.
      discriminator: D.
      env_state: of B simulators.
      rollout_policy: which policy acts in each, `[B]`.
      expected: next observations of the untouched simulator from the logged (s, a), `[K, M, O]`, where D wants them.
      key: for all later draws.
    """

    transformer: Transformer
    policy: TRPOState | PPOState
    average: Params
    value: ValueState
    discriminator: DiscriminatorState
    env_state: State
    rollout_policy: jax.Array
    expected: jax.Array | None
    key: jax.Array

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
    key: jax.Array,
    env: Env,
    policies: Actor,
    log: TargetLog,
    config: GroundingConfig,
    start: Transformer | None = None,
) -> GroundingState:
    """A fresh transformer (or one that goes on from `start`), D, values and simulators. `key` is consumed.

    Args:
      env: the simulator, without auto-reset.
      policies: actors of the K rollout policies, every leaf `[K, ...]`.
      log: transitions of the same K policies in the target.
    """
    size = log.count.shape[0]
    held = policies.action_scale.shape[0]
    if held != size:
        raise ValueError(f"the target log is of {size} rollout policies, but {held} policies were given")
    key_policy, key_value, key_discriminator, key_start, key = jax.random.split(key, 5)
    pi_g = start
    if pi_g is None:
        pi_g = transformer.init(key_policy, env.observation_size, env.action_size, config.transformer)
    starts = jax.vmap(lambda k: _start(k, env, log, config))(jax.random.split(key_start, config.num_envs))
    return GroundingState(
        transformer=pi_g,
        policy=_algorithm(config).init(pi_g.params, config.policy),
        average=jax.tree.map(jnp.copy, pi_g.params),
        value=value.init(key_value, env.observation_size + env.action_size, config.value(size)),
        discriminator=discriminator.init(
            key_discriminator, env.observation_size, env.action_size, config.discriminator
        ),
        env_state=starts[0],
        rollout_policy=starts[1],
        expected=jax.vmap(jax.vmap(env.predict))(log.observation, log.action)
        if _needs_expected(config)
        else None,
        key=key,
    )


def update(
    state: GroundingState, env: Env, policies: Actor, log: TargetLog, config: GroundingConfig
) -> tuple[GroundingState, Metrics]:
    """One outer iteration: collect B * T steps, then update D, pi_g and the values. Arguments as in `init`.

    Returns:
      The next state and metrics, each `[]`: those of D, of the policy update and of the values, the mean `reward`,
      and the mean `log_std` of pi_g.
    """
    key_collect, key_d, key_policy, key_value, key = jax.random.split(state.key, 5)
    env_state, rollout_policy, rows = _collect(key_collect, state, env, policies, log, config)
    grounded = Transitions(rows.observation, rows.action, rows.next_observation, rows.expected)
    learned, d_metrics = _update_discriminator(
        key_d, state.discriminator, grounded, rows.rollout_policy, log, state.expected, config
    )
    judge = learned if config.discriminator_first else state.discriminator
    rewards = discriminator.reward(judge, grounded, config.discriminator)

    inputs = transformer.network_inputs(state.transformer, rows.observation, rows.action)
    # gamma = 0: the return is the reward.
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


def _needs_expected(config: GroundingConfig) -> bool:
    return config.discriminator.next_as == "residual"


def _less_siblings(rewards: jax.Array, config: GroundingConfig) -> jax.Array:
    """Rewards `[T * J * B]` less the mean of the other draws at the same state."""
    of_state = rewards.reshape(config.steps_per_iteration, config.branches, config.num_envs)
    others = (jnp.sum(of_state, axis=1, keepdims=True) - of_state) / (config.branches - 1)
    return (of_state - others).reshape(-1)


class _Rows(flax.struct.PyTreeNode):
    observation: jax.Array
    action: jax.Array
    next_observation: jax.Array
    delta: jax.Array
    log_prob: jax.Array
    rollout_policy: jax.Array
    expected: jax.Array | None


def _collect(
    key: jax.Array, state: GroundingState, env: Env, policies: Actor, log: TargetLog, config: GroundingConfig
) -> tuple[State, jax.Array, _Rows]:
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)
    pi_g = state.current
    every = jnp.arange(config.num_envs)

    def body(carry: tuple[State, jax.Array], key: jax.Array) -> tuple[Any, _Rows]:
        env_state, which = carry
        key_act, key_delta, key_start = jax.random.split(key, 3)
        obs = env_state.obs
        # All K policies act and one is picked: cheaper than gathering B copies of a policy's weights.
        keys = jax.random.split(key_act, policies.action_scale.shape[0])
        offers = jax.vmap(lambda actor, k: sac.act(actor, obs, k, config.rollout))(policies, keys)
        action = offers[which, every]
        # A branch is a copy of the whole row of simulators; the first is the one that goes on.
        expected = jax.vmap(env.predict)(obs, action) if _needs_expected(config) else None
        before, at, asked, asker, expected = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (config.branches, *x.shape)),
            (env_state, obs, action, which, expected),
        )
        delta, log_prob = transformer.sample(pi_g, key_delta, at, asked)
        executed = transformer.transform(delta, asked, low, high)
        reached = jax.vmap(jax.vmap(env.step))(before, executed)
        row = _Rows(at, asked, reached.info["next_obs"], delta, log_prob, asker, expected)
        after = jax.tree.map(lambda x: x[0], reached)
        ended = after.done > 0
        if config.restart_steps:
            ended = ended | (after.info["steps"] >= config.restart_steps)
        fresh = jax.vmap(lambda k: _start(k, env, log, config))(jax.random.split(key_start, config.num_envs))
        carry = jax.tree.map(
            lambda new, old: jnp.where(ended.reshape(ended.shape + (1,) * (new.ndim - 1)), new, old),
            fresh,
            (after, which),
        )
        return carry, row

    keys = jax.random.split(key, config.steps_per_iteration)
    # Rows [T, J, B, ...].
    (env_state, which), rows = jax.lax.scan(body, (state.env_state, state.rollout_policy), keys)
    return env_state, which, jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:]), rows)


def _start(key: jax.Array, env: Env, log: TargetLog, config: GroundingConfig) -> tuple[State, jax.Array]:
    """The first state of an episode, and the rollout policy drawn for it."""
    key_policy, key_state = jax.random.split(key)
    which = jax.random.randint(key_policy, (), 0, log.count.shape[0])
    if config.restart_steps:
        row = jax.random.randint(key_state, (), 0, log.count[which])
        return env.state_from_obs(log.observation[which, row]), which
    return env.reset(key_state), which


def _update_discriminator(
    key: jax.Array,
    state: DiscriminatorState,
    grounded: Transitions,
    which: jax.Array,
    log: TargetLog,
    expected: jax.Array | None,
    config: GroundingConfig,
) -> tuple[DiscriminatorState, Metrics]:
    count = config.discriminator_batch

    def step(state: DiscriminatorState, key: jax.Array) -> tuple[DiscriminatorState, Metrics]:
        key_grounded, key_target, key_update = jax.random.split(key, 3)
        rows = jax.random.randint(key_grounded, (count,), 0, which.shape[0])
        # As many target rows of a policy as grounded rows of it, with replacement (facts 13 and 14 of the release).
        of = which[rows]
        at = jax.random.randint(key_target, (count,), 0, log.count[of])
        every = Transitions(log.observation, log.action, log.next_observation, expected)
        target = jax.tree.map(lambda x: x[of, at], every)
        chosen = jax.tree.map(lambda x: x[rows], grounded)
        return discriminator.update(state, chosen, target, key_update, config.discriminator)

    state, metrics = jax.lax.scan(step, state, jax.random.split(key, config.discriminator_updates))
    return state, jax.tree.map(lambda x: x[-1], metrics)
