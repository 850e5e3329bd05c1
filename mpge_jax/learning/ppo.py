"""Proximal policy optimisation, clipped objective (Schulman et al., 2017, https://arxiv.org/abs/1707.06347)."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Int, PRNGKeyArray

from mpge_jax.learning.distributions import gaussian_entropy, gaussian_log_prob
from mpge_jax.learning.policy_gradient import (
    Distribution,
    Metrics,
    Params,
    PolicyBatch,
    minibatch_indices,
    standardise,
)


@dataclass(frozen=True)
class PPOConfig:
    """Settings of one PPO update.

    Attributes:
      learning_rate: of Adam.
      clip: the ratio new / old counts up to `1 +- clip`.
      epochs: passes over the batch.
      minibatch_size: rows of one gradient step.
      max_gradient_norm: longer gradients are shortened to it.
    """

    learning_rate: float = 3e-4
    clip: float = 0.2
    epochs: int = 10
    minibatch_size: int = 256
    max_gradient_norm: float = 0.5

    def __post_init__(self) -> None:
        for name in ("learning_rate", "clip", "epochs", "minibatch_size", "max_gradient_norm"):
            if not getattr(self, name) > 0:
                raise ValueError(f"PPOConfig: {name} must be positive, got {getattr(self, name)}.")


class PPOState(struct.PyTreeNode):
    """A policy and the state of its optimiser."""

    params: Params
    optimiser: optax.OptState


def _optimiser(config: PPOConfig) -> optax.GradientTransformation:
    return optax.chain(optax.clip_by_global_norm(config.max_gradient_norm), optax.adam(config.learning_rate))


def init(params: Params, config: PPOConfig) -> PPOState:
    """State from the parameters of a policy."""
    return PPOState(params=params, optimiser=_optimiser(config).init(params))


def update(
    state: PPOState, batch: PolicyBatch, key: PRNGKeyArray, distribution: Distribution, config: PPOConfig
) -> tuple[PPOState, Metrics]:
    """`config.epochs` passes of minibatch gradient steps on the clipped objective. `key` is consumed.

    Returns:
      The new state and metrics, each `[]`: `kl` (nats, old to new, estimated on the batch), `improvement` of
      the clipped objective (in standard deviations of the advantage), `clip_fraction` (rows beyond the clip
      after the update), `entropy` (nats, after the update), `gradient_norm` (mean over the steps, before
      shortening).
    """
    batch = replace(batch, advantages=standardise(batch.advantages))
    optimiser = _optimiser(config)

    def log_ratio(params: Params, rows: PolicyBatch) -> Float[Array, " B"]:
        return gaussian_log_prob(rows.actions, *distribution(params, rows.inputs)) - rows.log_probs

    def loss(params: Params, rows: PolicyBatch) -> Float[Array, ""]:
        return -jnp.mean(clipped_objective(jnp.exp(log_ratio(params, rows)), rows.advantages, config.clip))

    def step(carry: PPOState, indices: Int[Array, " M"]) -> tuple[PPOState, Float[Array, ""]]:
        rows = jax.tree.map(lambda x: x[indices], batch)
        gradient = jax.grad(loss)(carry.params, rows)
        change, optimiser_state = optimiser.update(gradient, carry.optimiser, carry.params)
        params = optax.apply_updates(carry.params, change)
        return PPOState(params=params, optimiser=optimiser_state), optax.tree.norm(gradient)

    indices = minibatch_indices(key, batch.inputs.shape[0], config.minibatch_size, config.epochs)
    new_state, gradient_norms = jax.lax.scan(step, state, indices)

    final = log_ratio(new_state.params, batch)
    metrics = {
        # http://joschu.net/blog/kl-approx.html: unbiased and never negative.
        "kl": jnp.mean(jnp.expm1(final) - final),
        "improvement": loss(state.params, batch) - loss(new_state.params, batch),
        "clip_fraction": jnp.mean((jnp.abs(jnp.expm1(final)) > config.clip).astype(jnp.float32)),
        "entropy": jnp.mean(gaussian_entropy(distribution(new_state.params, batch.inputs[:1])[1])),
        "gradient_norm": jnp.mean(gradient_norms),
    }
    return new_state, metrics


def clipped_objective(
    ratio: Float[Array, "*n"], advantages: Float[Array, "*n"], clip: float
) -> Float[Array, "*n"]:
    """`min(ratio A, clip(ratio, 1 - clip, 1 + clip) A)` for each row (equation 7)."""
    return jnp.minimum(ratio * advantages, jnp.clip(ratio, 1.0 - clip, 1.0 + clip) * advantages)
