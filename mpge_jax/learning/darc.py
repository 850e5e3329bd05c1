"""DARC: a reward for going where the target could have gone too (Eysenbach et al., ICLR 2021, arXiv:2006.13916).

An agent trains in the source, and pays for transitions that the target does not have. Two classifiers tell the source's
transitions from those of the target's log (section 4 of the paper):

    r~ = r + log p(target | s, a, s') - log p(source | s, a, s') - log p(target | s, a) + log p(source | s, a)
       = r + l(s, a, s') - l(s, a),       l the classifiers' logits

which is the log-ratio of both dynamics' densities, log p_target(s'|s, a) - log p_source(s'|s, a), where they are exact.
Gaussian noise on the classifiers' inputs keeps them from telling the few logged transitions by heart. The paper records
in the target with the agent itself, again and again; here the metered log of the rollout policies is all there is.

Shapes: `B` batch size, `R` rows of the log, `O` observation, `A` action size.
"""

from dataclasses import dataclass
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray

from envs import Environment
from mpge_jax.learning import agent, sac
from mpge_jax.learning import buffer as replay
from mpge_jax.learning.agent import AgentConfig, AgentState
from mpge_jax.learning.networks import MLP, initial
from mpge_jax.learning.policy_gradient import Metrics
from mpge_jax.learning.sac import SACState


@dataclass(frozen=True)
class DARCConfig:
    """The classifiers; the defaults of sizes, rate and noise are the paper's.

    Attributes:
      hidden: widths of the hidden ReLU layers.
      learning_rate: Adam's.
      noise: standard deviation of the noise on inputs, in their own units.
      batch_size: rows of each side in an update.
      limit: largest size of the correction.

    Raises:
      ValueError: a value out of its range.
    """

    hidden: tuple[int, ...] = (256,)
    learning_rate: float = 3e-4
    noise: float = 1.0
    batch_size: int = 128
    limit: float = 10.0

    def __post_init__(self) -> None:
        if not self.learning_rate > 0 or not self.limit > 0 or self.noise < 0 or self.batch_size < 1:
            raise ValueError(
                "learning_rate, limit and batch_size must be positive and noise at least 0, got "
                f"{self.learning_rate}, {self.limit}, {self.batch_size} and {self.noise}"
            )


class Rows(flax.struct.PyTreeNode):
    """Transitions of one side.

    Attributes:
      obs, action, next_obs: s, a, s'.
    """

    obs: Float[Array, "*n O"]
    action: Float[Array, "*n A"]
    next_obs: Float[Array, "*n O"]


class Classifiers(flax.struct.PyTreeNode):
    """Two networks whose logits are positive where the target is likelier.

    Attributes:
      with_next, without: parameters of l(s, a, s') and of l(s, a).
      opt: state of Adam.
    """

    with_next: Any
    without: Any
    opt: Any


def _net(config: DARCConfig) -> MLP:
    return MLP((*config.hidden, 1))


def init(key: PRNGKeyArray, obs_size: int, action_size: int, config: DARCConfig) -> Classifiers:
    """Fresh classifiers. `key` is consumed."""
    one, two = jax.random.split(key)
    with_next = initial(_net(config), one, 2 * obs_size + action_size)
    without = initial(_net(config), two, obs_size + action_size)
    opt = optax.adam(config.learning_rate).init((with_next, without))
    return Classifiers(with_next, without, opt)


def _logits(params: Any, rows: Rows, config: DARCConfig) -> tuple[Float[Array, " B"], Float[Array, " B"]]:
    with_next, without = params
    short = jnp.concatenate([rows.obs, rows.action], axis=-1)
    long = jnp.concatenate([short, rows.next_obs], axis=-1)
    net = _net(config)
    return net.apply(with_next, long)[..., 0], net.apply(without, short)[..., 0]


def update(
    state: Classifiers, source: Rows, target: Rows, key: PRNGKeyArray, config: DARCConfig
) -> tuple[Classifiers, Metrics]:
    """One step of both on the cross-entropy of telling `target` `[B, ...]` from `source` `[B, ...]`. `key` is consumed.

    Returns:
      The next classifiers, and `classifier_loss`, the mean of both.
    """
    keys = jax.random.split(key, 6)

    def noisy(rows: Rows, keys: PRNGKeyArray) -> Rows:
        leaves, tree = jax.tree.flatten(rows)
        moved = [
            x + config.noise * jax.random.normal(k, x.shape, x.dtype)
            for x, k in zip(leaves, keys, strict=True)
        ]
        return jax.tree.unflatten(tree, moved)

    source, target = noisy(source, keys[:3]), noisy(target, keys[3:])

    def loss(params: Any) -> Float[Array, ""]:
        ours, theirs = _logits(params, source, config), _logits(params, target, config)
        parts = [jnp.mean(jax.nn.softplus(x)) for x in ours] + [jnp.mean(jax.nn.softplus(-x)) for x in theirs]
        return sum(parts, jnp.zeros(())) / 4

    params = (state.with_next, state.without)
    value, grads = jax.value_and_grad(loss)(params)
    updates, opt = optax.adam(config.learning_rate).update(grads, state.opt)
    with_next, without = optax.apply_updates(params, updates)
    return Classifiers(with_next, without, opt), {"classifier_loss": value}


def correction(state: Classifiers, rows: Rows, config: DARCConfig) -> Float[Array, " B"]:
    """What is added to the reward of transitions `[B, ...]` of the source, within `config.limit`."""
    long, short = _logits((state.with_next, state.without), rows, config)
    return jnp.clip(long - short, -config.limit, config.limit)


class DARCState(flax.struct.PyTreeNode):
    """Everything that an interrupted training needs to go on."""

    agent: AgentState
    classifiers: Classifiers


def init_agent(
    key: PRNGKeyArray,
    env: Environment,
    config: AgentConfig,
    darc: DARCConfig,
    learner: SACState | None = None,
) -> DARCState:
    """An agent as `agent.init` makes it, and fresh classifiers. `key` is consumed."""
    key_agent, key_classifiers = jax.random.split(key)
    made = agent.init(key_agent, env, config, learner)
    return DARCState(made, init(key_classifiers, env.observation_size, env.action_size, darc))


def iterate(
    state: DARCState,
    env: Environment,
    log: Rows,
    count: Int[Array, ""],
    config: AgentConfig,
    darc: DARCConfig,
    warm_up: int,
) -> tuple[DARCState, Metrics]:
    """One iteration of `agent.iterate`, each of whose updates is one of the classifiers too.

    Args:
      state: where training stands.
      env: the source, without auto-reset.
      log: the target's transitions, `[R, ...]`.
      count: how many of them are valid, the first ones.
      config, darc: as given to `init_agent`.
      warm_up: updates before the reward is corrected.
    """
    steps = config.steps_per_iteration // config.alternations
    updates = config.updates_per_iteration // config.alternations

    def learn(carry: Any, key: PRNGKeyArray) -> tuple[Any, Metrics]:
        learner, classifiers, buffer = carry
        key_batch, key_source, key_target, key_noise, key_sac = jax.random.split(key, 5)
        drawn = replay.sample(buffer, key_source, darc.batch_size)
        chosen = jax.random.randint(key_target, (darc.batch_size,), 0, count)
        theirs = jax.tree.map(lambda x: x[chosen], log)
        ours = Rows(drawn.obs, drawn.action, drawn.next_obs)
        classifiers, metrics = update(classifiers, ours, theirs, key_noise, darc)
        batch = replay.sample(buffer, key_batch, config.sac.batch_size)
        added = correction(classifiers, Rows(batch.obs, batch.action, batch.next_obs), darc)
        added = jnp.where(learner.step >= warm_up, added, 0.0)
        learner, more = sac.update(learner, batch.replace(reward=batch.reward + added), key_sac, config.sac)
        return (learner, classifiers, buffer), {**more, **metrics, "correction": jnp.mean(added)}

    def alternate(state: DARCState, _: None) -> tuple[DARCState, Metrics]:
        inner = state.agent
        key, key_act, key_update = jax.random.split(inner.key, 3)

        def policy(obs: Float[Array, "E O"], key: PRNGKeyArray) -> Float[Array, "E A"]:
            return sac.act(inner.learner.actor, obs, key)

        inner = agent.collect(inner.replace(key=key), env, policy, key_act, steps, None)
        carry = (inner.learner, state.classifiers, inner.buffer)
        (learner, classifiers, _buffer), metrics = jax.lax.scan(
            learn, carry, jax.random.split(key_update, updates)
        )
        metrics = jax.tree.map(lambda x: jnp.mean(x, axis=0), metrics)
        return DARCState(inner.replace(learner=learner), classifiers), metrics

    state, metrics = jax.lax.scan(alternate, state, None, config.alternations)
    metrics = jax.tree.map(lambda x: jnp.mean(x, axis=0), metrics)
    return state, {**metrics, "return": jnp.nanmean(state.agent.last_return)}
