"""What TRPO and PPO share: the batch they learn from, the policy they update, the treatment of advantages.

A policy is its parameters (any pytree) and a function `distribution(params, inputs) -> (mean, log_std)`, both
`[B, A]`: a diagonal Gaussian. `trpo` and `ppo` have the same two functions,

    init(params, config) -> State                 with `State.params`
    update(state, batch, key, distribution, config) -> (State, metrics)

so that either can stand in for the other.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, PRNGKeyArray, Scalar

Params = Any
Metrics = dict[str, Scalar]
Distribution = Callable[[Params, Float[Array, "B I"]], tuple[Float[Array, "B A"], Float[Array, "B A"]]]


class PolicyBatch(struct.PyTreeNode):
    """B decisions of the policy that is to be updated.

    Attributes:
      inputs: what the policy saw.
      actions: what it drew, before any clipping.
      log_probs: log-probability of `actions` when they were drawn.
      advantages: in any unit: `update` standardises them.
    """

    inputs: Float[Array, "*n B I"]
    actions: Float[Array, "*n B A"]
    log_probs: Float[Array, "*n B"]
    advantages: Float[Array, "*n B"]


def standardise(advantages: Float[Array, " B"]) -> Float[Array, " B"]:
    """Advantages with mean 0 and standard deviation 1; all zero where they are all alike.

    Called once an update, over the whole batch, by `trpo.update` and `ppo.update`, and nowhere else.
    """
    mean = advantages.mean()
    centred = advantages - mean
    spread = jnp.sqrt(jnp.mean(centred**2))
    # The mean of equal numbers need not be exactly that number: its rounding would be taken for advantages of 1.
    rounding = 8 * jnp.finfo(advantages.dtype).eps * jnp.abs(mean)
    return jnp.where(spread <= rounding, jnp.zeros_like(centred), centred / (spread + 1e-8))


def minibatch_indices(
    key: PRNGKeyArray, batch_size: int, minibatch_size: int, epochs: int
) -> Int[Array, "S M"]:
    """Row numbers of all S minibatches of M, `epochs * (batch_size // minibatch_size)`, a fresh shuffle every epoch.

    The rows that do not fill a last minibatch sit out that epoch. `key` is consumed.
    """
    if minibatch_size > batch_size:
        raise ValueError(
            f"A minibatch of {minibatch_size} rows cannot be drawn from a batch of {batch_size}; "
            "lower the minibatch size or collect more steps."
        )
    per_epoch = batch_size // minibatch_size
    shuffled = jax.vmap(lambda k: jax.random.permutation(k, batch_size))(jax.random.split(key, epochs))
    return shuffled[:, : per_epoch * minibatch_size].reshape(epochs * per_epoch, minibatch_size)
