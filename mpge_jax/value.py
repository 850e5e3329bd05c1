"""Values of rollout policies while grounding: what reward to expect at (s, a) under policy k.

With gamma = 0 the return is the reward, so a value is the mean reward and the advantage is `reward - value`.
The paper has K networks, its authors' experiments one network on (s, a, one-hot of k). The action transformer
and the discriminator never see k.
"""

from dataclasses import dataclass
from typing import Literal

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from flax import struct

from mpge_jax.networks import MLP, orthogonal
from mpge_jax.policy_gradient import Metrics, Params


@dataclass(frozen=True)
class ValueConfig:
    """Settings of the value functions.

    Attributes:
      policies: K, the number of rollout policies.
      heads: "separate" for K networks (the paper), "one_hot" for one that sees k (its authors' experiments).
      hidden: width of each tanh layer.
      learning_rate: of Adam.
      epochs: passes over the batch in an update.
      minibatch_size: rows of one gradient step, all heads together.
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

    @property
    def networks(self) -> int:
        """H, the number of networks: K or 1."""
        return self.policies if self.heads == "separate" else 1


class ValueState(struct.PyTreeNode):
    """Parameters, every leaf `[H, ...]`, and the state of their optimiser."""

    params: Params
    optimiser: optax.OptState


def _network(config: ValueConfig) -> nn.Module:
    return MLP((*config.hidden, 1), nn.tanh, hidden_init=orthogonal(2.0**0.5), final_init=orthogonal(1.0))


def init(key: jax.Array, input_size: int, config: ValueConfig) -> ValueState:
    """Fresh values of (s, a) with `input_size = O + A`. `key` is consumed."""
    features = input_size + (config.policies if config.heads == "one_hot" else 0)
    keys = jax.random.split(key, config.networks)
    params = jax.vmap(_network(config).init, in_axes=(0, None))(keys, jnp.zeros((1, features)))
    return ValueState(params=params, optimiser=optax.adam(config.learning_rate).init(params))


def predict(params: Params, inputs: jax.Array, policy: jax.Array, config: ValueConfig) -> jax.Array:
    """Values `[B]` of `inputs` `[B, O + A]` under the rollout policies numbered `policy` `[B]`, from 0."""
    features, head = _features_and_head(inputs, policy, config)
    every_head = jax.vmap(_network(config).apply, in_axes=(0, None))(params, features)[..., 0]
    return jnp.take_along_axis(every_head, head[None], axis=0)[0]


def update(
    state: ValueState,
    inputs: jax.Array,
    policy: jax.Array,
    returns: jax.Array,
    key: jax.Array,
    config: ValueConfig,
) -> tuple[ValueState, Metrics]:
    """Regression of `returns` `[B]` on `inputs` `[B, O + A]` and `policy` `[B]`. `key` is consumed.

    A network whose policy has no row in the batch stays as it is.

    Returns:
      The new state and metrics, each `[]`: `value_loss` (mean squared error over the last epoch) and
      `explained_variance` (share of the variance of `returns` that the values explain before the update).
    """
    network, optimiser = _network(config), optax.adam(config.learning_rate)
    features, head = _features_and_head(inputs, policy, config)
    rows_of_head = jnp.sum(jax.nn.one_hot(head, config.networks), axis=0)

    def loss(params: Params, indices: jax.Array) -> tuple[jax.Array, jax.Array]:
        values = jax.vmap(network.apply)(params, features[indices])[..., 0]
        errors = jnp.mean((values - returns[indices]) ** 2, axis=-1)
        # A sum, because each network is to have the gradient of its own mean error.
        return jnp.sum(errors), jnp.vdot(errors, rows_of_head) / head.shape[0]

    def step(carry: ValueState, indices: jax.Array) -> tuple[ValueState, jax.Array]:
        gradient, error = jax.grad(loss, has_aux=True)(carry.params, indices)
        change, optimiser_state = optimiser.update(gradient, carry.optimiser)
        params = optax.apply_updates(carry.params, change)
        return ValueState(params=params, optimiser=optimiser_state), error

    new_state, errors = jax.lax.scan(step, state, _indices_by_head(key, head, rows_of_head, config))

    def keep_absent(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(rows_of_head.reshape((-1,) + (1,) * (new.ndim - 1)) > 0, new, old)

    unexplained = jnp.var(returns - predict(state.params, inputs, policy, config))
    metrics = {
        "value_loss": jnp.mean(errors.reshape(config.epochs, -1)[-1]),
        "explained_variance": 1.0 - unexplained / jnp.maximum(jnp.var(returns), 1e-8),
    }
    params = jax.tree.map(keep_absent, new_state.params, state.params)
    return ValueState(params=params, optimiser=new_state.optimiser), metrics


def _features_and_head(
    inputs: jax.Array, policy: jax.Array, config: ValueConfig
) -> tuple[jax.Array, jax.Array]:
    if config.heads == "separate":
        return inputs, policy
    one_hot = jax.nn.one_hot(policy, config.policies)
    return jnp.concatenate([inputs, one_hot], axis=-1), jnp.zeros_like(policy)


def _indices_by_head(
    key: jax.Array, head: jax.Array, rows_of_head: jax.Array, config: ValueConfig
) -> jax.Array:
    """Row numbers `[steps, H, minibatch / H]`, each network's own rows only, shuffled anew every epoch.

    How many rows a network has is not known when the program is compiled. So each gets an equal share of
    every minibatch. With fewer rows than its share of an epoch it goes round them again, with more it leaves
    some out.
    """
    size = head.shape[0]
    share = -(-config.minibatch_size // config.networks)
    steps = max(1, size // (share * config.networks))
    first = jnp.cumsum(rows_of_head) - rows_of_head
    turn = jnp.arange(steps * share, dtype=rows_of_head.dtype)
    # [H, steps * share]: positions in the order that lists the rows of head 0, then those of head 1, ...
    position = first[:, None] + turn[None] % jnp.maximum(rows_of_head, 1.0)[:, None]
    position = jnp.minimum(position.astype(jnp.int32), size - 1)

    def epoch(epoch_key: jax.Array) -> jax.Array:
        order = jnp.argsort(head + 0.5 * jax.random.uniform(epoch_key, (size,)))
        return order[position].reshape(config.networks, steps, share).swapaxes(0, 1)

    indices = jax.vmap(epoch)(jax.random.split(key, config.epochs))
    return indices.reshape(config.epochs * steps, config.networks, share)
