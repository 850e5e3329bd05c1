"""Running mean and variance of a stream of batches (Chan, Golub and LeVeque, 1979), and scaling by them."""

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float


class RunningStats(struct.PyTreeNode):
    """Statistics of all rows seen so far.

    Attributes:
      count: number of rows; 0 at the start, when `normalise` is the identity.
      mean: of every feature.
      variance: population variance of every feature.
    """

    count: Float[Array, "*n"]
    mean: Float[Array, "*n F"]
    variance: Float[Array, "*n F"]


def init(size: int) -> RunningStats:
    """Statistics of no row at all: mean 0, variance 1."""
    return RunningStats(count=jnp.zeros(()), mean=jnp.zeros(size), variance=jnp.ones(size))


def update(stats: RunningStats, rows: Float[Array, "B F"]) -> RunningStats:
    """Statistics of the rows seen before and of `rows`, B > 0, together."""
    if rows.ndim != 2 or rows.shape[0] == 0 or rows.shape[1] != stats.mean.shape[0]:
        expected = f"[B > 0, {stats.mean.shape[0]}]"
        raise ValueError(f"normalise.update: expected rows of shape {expected}, got {list(rows.shape)}.")
    size = rows.shape[0]
    count = stats.count + size
    new_weight = size / count
    gap = rows.mean(axis=0) - stats.mean
    within = (1.0 - new_weight) * stats.variance + new_weight * rows.var(axis=0)
    return RunningStats(
        count=count,
        mean=stats.mean + new_weight * gap,
        variance=within + new_weight * (1.0 - new_weight) * gap**2,
    )


def scale(stats: RunningStats, floor: float) -> Float[Array, " F"]:
    """Standard deviation, at least `floor`: a feature that hardly moves is not blown up."""
    return jnp.maximum(jnp.sqrt(stats.variance), floor)


def normalise(stats: RunningStats, x: Float[Array, "*n F"], floor: float) -> Float[Array, "*n F"]:
    """`(x - mean) / max(std, floor)`."""
    shape = (1,) * (x.ndim - 1) + stats.mean.shape
    return (x - stats.mean.reshape(shape)) / scale(stats, floor).reshape(shape)
