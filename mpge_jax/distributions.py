"""Diagonal Gaussians, plain and squashed by tanh, as functions of `(mean, log_std)`.

Shapes: `mean`, `log_std`, `x` are `[..., A]`; log-probabilities, entropies and divergences are `[...]`.
"""

import math

import jax
import jax.numpy as jnp

_LOG_2PI = math.log(2 * math.pi)


def gaussian_sample(key: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
    """One reparameterised sample. `key` is consumed."""
    return mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape, mean.dtype)


def gaussian_log_prob(x: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
    """log N(x; mean, exp(log_std)^2), summed over the last axis."""
    z = (x - mean) * jnp.exp(-log_std)
    return jnp.sum(-0.5 * z**2 - log_std - 0.5 * _LOG_2PI, axis=-1)


def gaussian_entropy(log_std: jax.Array) -> jax.Array:
    """Differential entropy in nats, summed over the last axis."""
    return jnp.sum(log_std + 0.5 * (1.0 + _LOG_2PI), axis=-1)


def gaussian_kl(
    mean_p: jax.Array, log_std_p: jax.Array, mean_q: jax.Array, log_std_q: jax.Array
) -> jax.Array:
    """KL(p || q) in nats, summed over the last axis."""
    variance_ratio = jnp.exp(2.0 * (log_std_p - log_std_q))
    scaled = (mean_p - mean_q) * jnp.exp(-log_std_q)
    return jnp.sum(log_std_q - log_std_p + 0.5 * (variance_ratio + scaled**2 - 1.0), axis=-1)


def tanh_gaussian_sample(
    key: jax.Array, mean: jax.Array, log_std: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """A sample of tanh(N(mean, exp(log_std)^2)) with its log-probability. `key` is consumed.

    Returns:
      `(action [..., A] in (-1, 1), log_prob [...], pre_tanh [..., A])`.
    """
    pre_tanh = gaussian_sample(key, mean, log_std)
    log_prob = gaussian_log_prob(pre_tanh, mean, log_std) - tanh_log_det(pre_tanh)
    return jnp.tanh(pre_tanh), log_prob, pre_tanh


def tanh_log_det(pre_tanh: jax.Array) -> jax.Array:
    """log |d tanh(x) / dx| summed over the last axis, in the form that does not underflow (Haarnoja 2018, App. C)."""
    return jnp.sum(2.0 * (math.log(2.0) - pre_tanh - jax.nn.softplus(-2.0 * pre_tanh)), axis=-1)
