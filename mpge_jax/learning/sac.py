"""Soft actor-critic with automatic temperature (Haarnoja et al. 2018, arXiv:1812.05905).

A pair of pure functions, `init` and `update`, and `update_many`, which runs any number of updates from a
replay buffer on the device in one compiled call. Everything vmaps over seeds: a leading axis on state, buffer
and keys.

    y      = r + gamma (1 - terminated) (min_i Q'_i(s', a') - alpha log pi(a'|s')),   a' ~ pi(.|s')
    critic : min 1/2 sum_i mean (Q_i(s, a) - y)^2
    actor  : min mean (alpha log pi(a|s) - min_i Q_i(s, a)),                          a ~ pi(.|s)
    alpha  : min -log(alpha) mean (log pi(a|s) + target entropy)
    target : Q'_i <- tau Q_i + (1 - tau) Q'_i

Log-probabilities are of the action squashed to (-1, 1), before it is scaled to the environment's units. The
order is that of Stable-Baselines3, the paper's agent: critics first, then the actor on the new critics, both
with the temperature from before the step.

Shapes: `B` batch size, `O` observation size, `A` action size.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct
from flax.linen.initializers import variance_scaling
from jaxtyping import Array, ArrayLike, Float, Int, PRNGKeyArray

from mpge_jax.learning import buffer as replay
from mpge_jax.learning.buffer import ReplayBuffer, Transition
from mpge_jax.learning.distributions import gaussian_entropy, tanh_gaussian_sample
from mpge_jax.learning.networks import MLP, initial, widths
from mpge_jax.learning.policy_gradient import Metrics

LOG_STD_MIN, LOG_STD_MAX = -20.0, 2.0
# U(+-1/sqrt(fan_in)), PyTorch's default: what the paper's agent (Stable-Baselines3) starts from.
_INIT = variance_scaling(1.0 / 3.0, "fan_in", "uniform")


@dataclass(frozen=True)
class SACConfig:
    """Hyperparameters; the defaults are the paper's.

    Attributes:
      hidden: widths of the hidden ReLU layers of actor and critics.
      actor_lr, critic_lr, alpha_lr: Adam learning rates.
      tau: rate of the moving average of the target critics.
      gamma: discount.
      batch_size: transitions an update learns from.
      target_entropy: what the temperature steers the entropy of the action squashed to (-1, 1) to, in nats;
        `-A` where None.
      init_alpha: temperature at the start.

    Raises:
      ValueError: a value out of its range.
    """

    hidden: tuple[int, ...] = (256, 256)
    actor_lr: float = 3e-4
    critic_lr: float = 3e-4
    alpha_lr: float = 3e-4
    tau: float = 0.005
    gamma: float = 0.99
    batch_size: int = 256
    target_entropy: float | None = None
    init_alpha: float = 1.0

    def __post_init__(self) -> None:
        if not self.hidden or min(self.hidden) < 1:
            raise ValueError(f"hidden must list one or more positive layer widths, got {self.hidden}")
        for name in ("actor_lr", "critic_lr", "alpha_lr", "init_alpha"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not 0 < self.tau <= 1:
            raise ValueError(f"tau must lie in (0, 1], got {self.tau}")
        if not 0 <= self.gamma <= 1:
            raise ValueError(f"gamma must lie in [0, 1], got {self.gamma}")
        if self.batch_size < 1:
            raise ValueError(f"batch_size must be at least 1, got {self.batch_size}")


class Actor(struct.PyTreeNode):
    """A policy: all that is needed to act.

    Attributes:
      params: of the network `obs -> (mean, log_std)`.
      action_scale, action_middle: half the width of the action box, and its middle; actions are
        `action_middle + tanh(.) * action_scale`.
    """

    params: Any
    action_scale: Float[Array, "*n A"]
    action_middle: Float[Array, "*n A"]

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        return widths(self.params)[:-1]


class SACState(struct.PyTreeNode):
    """All that learning needs to go on.

    Attributes:
      actor: the policy.
      critic, target_critic: parameters of both Q networks, a leading axis of 2 on every leaf.
      log_alpha: logarithm of the temperature.
      actor_opt, critic_opt, alpha_opt: states of Adam.
      step: updates so far.
    """

    actor: Actor
    critic: Any
    target_critic: Any
    log_alpha: Float[Array, "*n"]
    actor_opt: optax.OptState
    critic_opt: optax.OptState
    alpha_opt: optax.OptState
    step: Int[Array, "*n"]


def _actor_net(hidden: tuple[int, ...], action_size: int) -> MLP:
    return MLP((*hidden, 2 * action_size), hidden_init=_INIT)


def _critic_net(config: SACConfig) -> MLP:
    return MLP((*config.hidden, 1), hidden_init=_INIT)


def init(
    key: PRNGKeyArray,
    obs_size: int,
    action_size: int,
    action_scale: Float[ArrayLike, " A"],
    config: SACConfig,
    action_middle: Float[ArrayLike, " A"] | None = None,
) -> SACState:
    """Fresh networks and optimisers. `key` is consumed.

    Args:
      key: seeds the networks.
      obs_size, action_size: `O` and `A`.
      action_scale: half the width of the action box.
      config: hyperparameters.
      action_middle: the middle of the action box; 0 by default.

    Raises:
      ValueError: `action_scale` or `action_middle` is not `[A]`.
    """
    scale = jnp.asarray(action_scale, jnp.float32)
    middle = jnp.zeros_like(scale) if action_middle is None else jnp.asarray(action_middle, jnp.float32)
    for name, given in (("action_scale", scale), ("action_middle", middle)):
        if given.shape != (action_size,):
            raise ValueError(f"{name} must have shape ({action_size},), got {given.shape}")
    actor_params, critic = _init_networks(key, obs_size, action_size, config)
    return warm_start(
        Actor(actor_params, scale, middle), critic, jnp.log(jnp.float32(config.init_alpha)), config
    )


def warm_start(actor: Actor, critic: Any, log_alpha: Float[Array, ""], config: SACConfig) -> SACState:
    """Goes on from a trained policy: its actor, critics and temperature.

    Optimisers are fresh and the targets equal the critics. Everything is copied, so that the new state can be
    donated while the policy stays usable.

    Raises:
      ValueError: the networks do not have the shapes that `config.hidden` asks for.
    """
    if actor.hidden != tuple(config.hidden):
        raise ValueError(
            f"the policies have hidden layers {actor.hidden}, the configuration wants {config.hidden}"
        )
    actor, critic, log_alpha = jax.tree.map(jnp.copy, (actor, critic, log_alpha))
    return SACState(
        actor=actor,
        critic=critic,
        target_critic=jax.tree.map(jnp.copy, critic),
        log_alpha=log_alpha,
        actor_opt=optax.adam(config.actor_lr).init(actor.params),
        critic_opt=optax.adam(config.critic_lr).init(critic),
        alpha_opt=optax.adam(config.alpha_lr).init(log_alpha),
        step=jnp.zeros((), jnp.int32),
    )


def _init_networks(key: PRNGKeyArray, obs_size: int, action_size: int, config: SACConfig) -> tuple[Any, Any]:
    actor_key, critic_key = jax.random.split(key)
    actor_params = initial(_actor_net(config.hidden, action_size), actor_key, obs_size)
    keys = jax.random.split(critic_key)
    critic = jax.vmap(lambda key: initial(_critic_net(config), key, obs_size + action_size))(keys)
    return actor_params, critic


def distribution(
    actor: Actor, obs: Float[Array, "*n O"]
) -> tuple[Float[Array, "*n A"], Float[Array, "*n A"]]:
    """Mean and log-std of the Gaussian before squashing, at `obs`."""
    out = _actor_net(actor.hidden, actor.action_scale.shape[-1]).apply(actor.params, obs)
    mean, log_std = jnp.split(out, 2, axis=-1)
    return mean, jnp.clip(log_std, LOG_STD_MIN, LOG_STD_MAX)


def _scaled(actor: Actor, squashed: Float[Array, "*n A"]) -> Float[Array, "*n A"]:
    middle, scale = (jnp.broadcast_to(x, squashed.shape) for x in (actor.action_middle, actor.action_scale))
    return middle + squashed * scale


def act(actor: Actor, obs: Float[Array, "*n O"], key: PRNGKeyArray | None = None) -> Float[Array, "*n A"]:
    """Actions at `obs`: a sample where a key is given (consumed), else the mode."""
    mean, log_std = distribution(actor, obs)
    squashed = jnp.tanh(mean) if key is None else tanh_gaussian_sample(key, mean, log_std)[0]
    return _scaled(actor, squashed)


def policy_entropy(actor: Actor, obs: Float[Array, "*n O"]) -> Float[Array, "*n"]:
    """Entropy in nats of the Gaussian before squashing."""
    return gaussian_entropy(distribution(actor, obs)[1])


def q_values(
    critic: Any, obs: Float[Array, "B O"], action: Float[Array, "B A"], config: SACConfig
) -> Float[Array, "2 B"]:
    """Both critics at `(obs, action)`."""
    x = jnp.concatenate([obs, action], axis=-1)
    return jax.vmap(_critic_net(config).apply, (0, None))(critic, x)[..., 0]


def update(
    state: SACState, batch: Transition, key: PRNGKeyArray, config: SACConfig
) -> tuple[SACState, Metrics]:
    """One step on critics, actor, temperature and target critics. `key` is consumed.

    Args:
      state: where learning stands.
      batch: fields `[B, ...]`.
      key: draws the actions at `s` and `s'`.
      config: hyperparameters.

    Returns:
      The next state and scalars: `critic_loss`, `actor_loss`, `alpha` (before the step), `entropy` (of the
      squashed action, estimated on the batch), `q_mean`.

    Raises:
      ValueError: a field of the batch has another shape.
    """
    action_size = state.actor.action_scale.shape[-1]
    replay.check_shapes(batch, batch.obs.shape[-1], action_size)
    target_key, actor_key = jax.random.split(key)
    alpha = jnp.exp(state.log_alpha)
    target_entropy = -float(action_size) if config.target_entropy is None else config.target_entropy

    next_distribution = distribution(state.actor, batch.next_obs)
    next_squashed, next_log_prob, _ = tanh_gaussian_sample(target_key, *next_distribution)
    next_action = _scaled(state.actor, next_squashed)
    next_q = q_values(state.target_critic, batch.next_obs, next_action, config).min(axis=0)
    target = batch.reward + config.gamma * (1.0 - batch.terminated) * (next_q - alpha * next_log_prob)

    def critic_loss_fn(critic: Any) -> tuple[Float[Array, ""], Float[Array, ""]]:
        q = q_values(critic, batch.obs, batch.action, config)
        return 0.5 * jnp.square(q - target[None]).mean(axis=1).sum(), q.mean()

    (critic_loss, q_mean), grads = jax.value_and_grad(critic_loss_fn, has_aux=True)(state.critic)
    updates, critic_opt = optax.adam(config.critic_lr).update(grads, state.critic_opt)
    critic = optax.apply_updates(state.critic, updates)

    def actor_loss_fn(params: Any) -> tuple[Float[Array, ""], Float[Array, " B"]]:
        actor = replace(state.actor, params=params)
        squashed, log_prob, _ = tanh_gaussian_sample(actor_key, *distribution(actor, batch.obs))
        q = q_values(critic, batch.obs, _scaled(actor, squashed), config).min(axis=0)
        return (alpha * log_prob - q).mean(), log_prob

    (actor_loss, log_prob), grads = jax.value_and_grad(actor_loss_fn, has_aux=True)(state.actor.params)
    updates, actor_opt = optax.adam(config.actor_lr).update(grads, state.actor_opt)
    actor = replace(state.actor, params=optax.apply_updates(state.actor.params, updates))

    # d/d(log alpha) of -log_alpha * (log_prob + target_entropy): up where the entropy is below its target.
    alpha_grad = -(log_prob + target_entropy).mean()
    alpha_update, alpha_opt = optax.adam(config.alpha_lr).update(alpha_grad, state.alpha_opt)

    new = SACState(
        actor=actor,
        critic=critic,
        target_critic=optax.incremental_update(critic, state.target_critic, config.tau),
        log_alpha=optax.apply_updates(state.log_alpha, alpha_update),
        actor_opt=actor_opt,
        critic_opt=critic_opt,
        alpha_opt=alpha_opt,
        step=state.step + 1,
    )
    metrics = {
        "critic_loss": critic_loss,
        "actor_loss": actor_loss,
        "alpha": alpha,
        "entropy": -log_prob.mean(),
        "q_mean": q_mean,
    }
    return new, metrics


def update_many(
    state: SACState, buffer: ReplayBuffer, key: PRNGKeyArray, n: int, config: SACConfig
) -> tuple[SACState, Metrics]:
    """`n` updates, each on its own batch from `buffer`; metrics are averaged over them. `key` is consumed.

    Raises:
      ValueError: `n` below 1.
    """
    if n < 1:
        raise ValueError(f"the number of updates must be at least 1, got {n}")

    def body(state: SACState, key: PRNGKeyArray) -> tuple[SACState, Metrics]:
        sample_key, update_key = jax.random.split(key)
        return update(state, replay.sample(buffer, sample_key, config.batch_size), update_key, config)

    state, metrics = jax.lax.scan(body, state, jax.random.split(key, n))
    return state, jax.tree.map(partial(jnp.mean, axis=0), metrics)
