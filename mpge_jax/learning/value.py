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
from jaxtyping import Array, Float, Int, PRNGKeyArray

from envs.select import select
from mpge_jax.learning.networks import MLP, initial, orthogonal
from mpge_jax.learning.policy_gradient import Metrics, Params


@dataclass(frozen=True)
class ValueConfig:
    """Settings of the value functions.

    Attributes:
      policies: K, the number of rollout policies.
      heads: "separate" for K networks (the paper), "one_hot" for one that sees k (its authors' experiments).
      hidden: width of each tanh layer.
      learning_rate: of Adam.
      epochs: passes of every network over its own rows in an update.
      minibatch_size: rows of one gradient step of one network.
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
    """Parameters, every leaf `[H, ...]`, and the state of Adam of each, every leaf `[H, ...]`."""

    params: Params
    optimiser: optax.OptState


def _network(config: ValueConfig) -> nn.Module:
    return MLP((*config.hidden, 1), nn.tanh, hidden_init=orthogonal(2.0**0.5), final_init=orthogonal(1.0))


def init(key: PRNGKeyArray, input_size: int, config: ValueConfig) -> ValueState:
    """Fresh values of (s, a) with `input_size = O + A`. `key` is consumed."""
    features = input_size + (config.policies if config.heads == "one_hot" else 0)
    keys = jax.random.split(key, config.networks)
    params = jax.vmap(lambda key: initial(_network(config), key, features))(keys)
    return ValueState(params=params, optimiser=jax.vmap(optax.adam(config.learning_rate).init)(params))


def predict(
    params: Params, inputs: Float[Array, "B I"], policy: Int[Array, " B"], config: ValueConfig
) -> Float[Array, " B"]:
    """Values of `inputs`, I = O + A, under the rollout policies numbered `policy`, from 0."""
    features, head = _features_and_head(inputs, policy, config)
    every_head = jax.vmap(_network(config).apply, in_axes=(0, None))(params, features)[..., 0]
    return jnp.take_along_axis(every_head, head[None], axis=0)[0]


def update(
    state: ValueState,
    inputs: Float[Array, "B I"],
    policy: Int[Array, " B"],
    returns: Float[Array, " B"],
    key: PRNGKeyArray,
    config: ValueConfig,
) -> tuple[ValueState, Metrics]:
    """Regression of `returns` on `inputs`, I = O + A, and `policy`. `key` is consumed.

    Every network goes through all its own rows once an epoch, in minibatches of them alone; the last of an epoch may
    be smaller. A network whose policy has no row in the batch stays as it is, its optimiser too.

    Returns:
      The new state and metrics, each `[]`: `value_loss` (mean squared error over the last epoch) and
      `explained_variance` (share of the variance of `returns` that the values explain before the update).
    """
    network, optimiser = _network(config), optax.adam(config.learning_rate)
    features, head = _features_and_head(inputs, policy, config)
    plan = _plan(key, head, config)

    def loss(
        params: Params, rows: Int[Array, " M"], weight: Float[Array, " M"]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        values = network.apply(params, features[rows])[..., 0]
        squared = jnp.sum(weight * (values - returns[rows]) ** 2)
        return squared / jnp.maximum(jnp.sum(weight), 1.0), squared

    def step(
        carry: ValueState, batch: tuple[Int[Array, ""], Int[Array, " M"], Float[Array, " M"]]
    ) -> tuple[ValueState, Float[Array, ""]]:
        which, rows, weight = batch
        own = jax.tree.map(lambda x: x[which], carry)
        gradient, squared = jax.grad(loss, has_aux=True)(own.params, rows, weight)
        change, optimiser_state = optimiser.update(gradient, own.optimiser)
        new = ValueState(params=optax.apply_updates(own.params, change), optimiser=optimiser_state)
        # Beyond the last minibatch of an epoch there is nothing to learn from.
        new = select(jnp.any(weight > 0), new, own)
        return jax.tree.map(lambda all_, one: all_.at[which].set(one), carry, new), squared

    new_state, squares = jax.lax.scan(step, state, plan)
    unexplained = jnp.var(returns - predict(state.params, inputs, policy, config))
    metrics = {
        "value_loss": jnp.sum(squares.reshape(config.epochs, -1)[-1]) / head.shape[0],
        "explained_variance": 1.0 - unexplained / jnp.maximum(jnp.var(returns), 1e-8),
    }
    return new_state, metrics


def _features_and_head(
    inputs: Float[Array, "B I"], policy: Int[Array, " B"], config: ValueConfig
) -> tuple[Float[Array, "B F"], Int[Array, " B"]]:
    if config.heads == "separate":
        return inputs, policy
    one_hot = jax.nn.one_hot(policy, config.policies)
    return jnp.concatenate([inputs, one_hot], axis=-1), jnp.zeros_like(policy)


def _plan(
    key: PRNGKeyArray, head: Int[Array, " B"], config: ValueConfig
) -> tuple[Int[Array, " S"], Int[Array, "S M"], Float[Array, "S M"]]:
    """S minibatches of all epochs, `(network, rows, weight)`, shuffled anew every epoch.

    How many rows a network has is not known when the program is compiled. So an epoch has as many steps as any
    division of the rows needs, and the networks take their minibatches one after the other; weight 0 marks what is
    beyond a network's last row, and steps that are left over.
    """
    size, networks, share = head.shape[0], config.networks, min(config.minibatch_size, head.shape[0])
    # Most are needed where all networks but one have a single row.
    steps = (size - networks) // share + networks if size > networks else networks
    rows_of = jnp.sum(jax.nn.one_hot(head, networks, dtype=jnp.int32), axis=0)
    first_row = jnp.cumsum(rows_of) - rows_of
    last_step = jnp.cumsum(-(-rows_of // share))
    step = jnp.arange(steps)
    which = jnp.minimum(jnp.searchsorted(last_step, step, side="right"), networks - 1)
    turn = step - (last_step[which] + -rows_of[which] // share)
    place = turn[:, None] * share + jnp.arange(share)[None, :]
    weight = (place < rows_of[which][:, None]).astype(jnp.float32)
    position = jnp.minimum(first_row[which][:, None] + place, size - 1)

    def epoch(epoch_key: PRNGKeyArray) -> Int[Array, "steps M"]:
        # The rows of network 0, then those of network 1, ..., each in random order.
        order = jnp.argsort(head + 0.5 * jax.random.uniform(epoch_key, (size,)))
        return order[position]

    rows = jax.vmap(epoch)(jax.random.split(key, config.epochs))
    repeat = lambda x: jnp.tile(x, (config.epochs,) + (1,) * (x.ndim - 1))  # noqa: E731
    return repeat(which), rows.reshape(-1, share), repeat(weight)
