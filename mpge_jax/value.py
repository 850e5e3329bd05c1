"""Values of rollout policies while grounding: what reward to expect at (s, a) under policy k.

With gamma = 0 the return is the reward, so a value is the mean reward and the advantage is `reward - value`. The
paper has K networks, the authors' experiments one network on (s, a, one-hot of k). The action transformer and the
discriminator never see k.
"""

from dataclasses import dataclass
from typing import Literal

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from flax import struct
from flax.linen.initializers import orthogonal

from mpge_jax.networks import MLP
from mpge_jax.policy_gradient import Metrics, Params, minibatch_indices


@dataclass(frozen=True)
class ValueConfig:
    """Settings of the value functions.

    Attributes:
      policies: K, the number of rollout policies.
      heads: "separate" for K networks (the paper), "one_hot" for one that sees k (the authors' experiments).
      hidden: width of each tanh layer.
      learning_rate: of Adam.
      epochs: passes over the batch in an update.
      minibatch_size: rows of one gradient step.
    """

    policies: int
    heads: Literal["separate", "one_hot"] = "separate"
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 1e-3
    epochs: int = 5
    minibatch_size: int = 128

    def __post_init__(self) -> None:
        for name in ("policies", "learning_rate", "epochs", "minibatch_size"):
            if not getattr(self, name) > 0:
                raise ValueError(f"ValueConfig: {name} must be positive, got {getattr(self, name)}.")
        if self.heads not in ("separate", "one_hot"):
            raise ValueError(f'ValueConfig: heads must be "separate" or "one_hot", got {self.heads!r}.')


@struct.dataclass
class ValueState:
    """Parameters (leading axis K where the networks are separate) and the state of their optimiser."""

    params: Params
    optimiser: optax.OptState


def _network(config: ValueConfig) -> nn.Module:
    return MLP((*config.hidden, 1), nn.tanh, hidden_init=orthogonal(2.0**0.5), final_init=orthogonal(1.0))


def init(key: jax.Array, input_size: int, config: ValueConfig) -> ValueState:
    """Fresh values of (s, a) with `input_size = O + A`. `key` is consumed."""
    network = _network(config)
    if config.heads == "one_hot":
        params = network.init(key, jnp.zeros((1, input_size + config.policies)))
    else:
        keys = jax.random.split(key, config.policies)
        params = jax.vmap(network.init, in_axes=(0, None))(keys, jnp.zeros((1, input_size)))
    return ValueState(params=params, optimiser=optax.adam(config.learning_rate).init(params))


def predict(params: Params, inputs: jax.Array, policy: jax.Array, config: ValueConfig) -> jax.Array:
    """Values `[B]` of `inputs` `[B, O + A]` under the rollout policies numbered `policy` `[B]`."""
    network = _network(config)
    one_hot = jax.nn.one_hot(policy, config.policies)
    if config.heads == "one_hot":
        return network.apply(params, jnp.concatenate([inputs, one_hot], axis=-1))[:, 0]
    every_head = jax.vmap(network.apply, in_axes=(0, None))(params, inputs)[..., 0]
    return jnp.sum(every_head.T * one_hot, axis=-1)


def update(
    state: ValueState,
    inputs: jax.Array,
    policy: jax.Array,
    returns: jax.Array,
    key: jax.Array,
    config: ValueConfig,
) -> tuple[ValueState, Metrics]:
    """Regression of `returns` `[B]` on `inputs` `[B, O + A]` and `policy` `[B]`. `key` is consumed.

    Returns:
      The new state and the metrics `value_loss` (mean squared error over the last epoch, `[]`) and
      `explained_variance` (of `returns`, by the values from before the update, `[]`).
    """
    optimiser = optax.adam(config.learning_rate)
    before = predict(state.params, inputs, policy, config)

    def loss(params: Params, rows: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        return jnp.mean((predict(params, rows[0], rows[1], config) - rows[2]) ** 2)

    def step(carry: ValueState, indices: jax.Array) -> tuple[ValueState, jax.Array]:
        rows = (inputs[indices], policy[indices], returns[indices])
        error, gradient = jax.value_and_grad(loss)(carry.params, rows)
        change, optimiser_state = optimiser.update(gradient, carry.optimiser)
        params = optax.apply_updates(carry.params, change)
        return ValueState(params=params, optimiser=optimiser_state), error

    indices = minibatch_indices(key, inputs.shape[0], config.minibatch_size, config.epochs)
    new_state, errors = jax.lax.scan(step, state, indices)
    last_epoch = errors.reshape(config.epochs, -1)[-1]
    metrics = {
        "value_loss": jnp.mean(last_epoch),
        "explained_variance": 1.0 - jnp.var(returns - before) / jnp.maximum(jnp.var(returns), 1e-8),
    }
    return new_state, metrics
