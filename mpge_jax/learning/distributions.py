"""Diagonal Gaussians, plain and squashed by tanh, as functions of `(mean, log_std)`; leading axes are free."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

_LOG_2PI = math.log(2 * math.pi)


def gaussian_sample(
    key: PRNGKeyArray, mean: Float[Array, "*n A"], log_std: Float[Array, "*n A"]
) -> Float[Array, "*n A"]:
    """One reparameterised sample. `key` is consumed."""
    return mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape, mean.dtype)


def gaussian_log_prob(
    x: Float[Array, "*n A"], mean: Float[Array, "*n A"], log_std: Float[Array, "*n A"]
) -> Float[Array, "*n"]:
    """log N(x; mean, exp(log_std)^2), summed over the last axis."""
    z = (x - mean) * jnp.exp(-log_std)
    return jnp.sum(-0.5 * z**2 - log_std - 0.5 * _LOG_2PI, axis=-1)


def gaussian_entropy(log_std: Float[Array, "*n A"]) -> Float[Array, "*n"]:
    """Differential entropy in nats, summed over the last axis."""
    return jnp.sum(log_std + 0.5 * (1.0 + _LOG_2PI), axis=-1)


def gaussian_kl(
    mean_p: Float[Array, "*n A"],
    log_std_p: Float[Array, "*n A"],
    mean_q: Float[Array, "*n A"],
    log_std_q: Float[Array, "*n A"],
) -> Float[Array, "*n"]:
    """KL(p || q) in nats, summed over the last axis."""
    variance_ratio = jnp.exp(2.0 * (log_std_p - log_std_q))
    scaled = (mean_p - mean_q) * jnp.exp(-log_std_q)
    return jnp.sum(log_std_q - log_std_p + 0.5 * (variance_ratio + scaled**2 - 1.0), axis=-1)


def tanh_gaussian_sample(
    key: PRNGKeyArray, mean: Float[Array, "*n A"], log_std: Float[Array, "*n A"]
) -> tuple[Float[Array, "*n A"], Float[Array, "*n"], Float[Array, "*n A"]]:
    """A sample of tanh(N(mean, exp(log_std)^2)) with its log-probability. `key` is consumed.

    Returns:
      `(action in (-1, 1), log_prob, pre_tanh)`.
    """
    pre_tanh = gaussian_sample(key, mean, log_std)
    log_prob = gaussian_log_prob(pre_tanh, mean, log_std) - tanh_log_det(pre_tanh)
    return jnp.tanh(pre_tanh), log_prob, pre_tanh


def tanh_log_det(pre_tanh: Float[Array, "*n A"]) -> Float[Array, "*n"]:
    """log |d tanh(x) / dx| summed over the last axis, in the form that does not underflow (Haarnoja 2018, App. C)."""
    return jnp.sum(2.0 * (math.log(2.0) - pre_tanh - jax.nn.softplus(-2.0 * pre_tanh)), axis=-1)
