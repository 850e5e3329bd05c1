"""Values of rollout policies while grounding: what reward to expect at (s, a) under policy k.

With gamma = 0 the return is the reward, so a value is the mean reward and the advantage is `reward - value`.
The paper has K networks, its authors' experiments one network on (s, a, one-hot of k). The action transformer
and the discriminator never see k.
"""

from dataclasses import dataclass
from typing import Any, Literal

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Int, PRNGKeyArray

from envs.select import select
from mpge_jax.learning import grouped, lockstep
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
    return grouped.apply(_network(config).apply, params, features, head)[..., 0]


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
        values = network.apply(params, grouped.take(features, rows))[..., 0]
        squared = jnp.sum(weight * (values - grouped.take(returns, rows)) ** 2)
        return squared / jnp.maximum(jnp.sum(weight), 1.0), squared

    def step(
        own: ValueState, rows: Int[Array, " M"], weight: Float[Array, " M"]
    ) -> tuple[ValueState, Float[Array, ""]]:
        gradient, squared = jax.grad(loss, has_aux=True)(own.params, rows, weight)
        change, optimiser_state = optimiser.update(gradient, own.optimiser)
        return ValueState(params=optax.apply_updates(own.params, change), optimiser=optimiser_state), squared

    def turn(carry: tuple[Int[Array, ""], ValueState, Float[Array, ""]]) -> Any:
        """The next minibatch of every network; those that have no more stay as they are."""
        number, networks, last_epoch = carry
        epoch, rows, weight = plan.minibatches(number)
        new, squared = jax.vmap(step)(networks, rows, weight)
        last_epoch += jnp.sum(jnp.where(epoch == config.epochs - 1, squared, 0.0))
        return number + 1, select(number < plan.turns, new, networks), last_epoch

    most = lockstep.largest(jnp.max(plan.turns))
    start = (jnp.zeros_like(most), state, jnp.zeros(()))
    _, new_state, last_epoch = jax.lax.while_loop(lambda carry: carry[0] < most, turn, start)
    unexplained = jnp.var(returns - predict(state.params, inputs, policy, config))
    metrics = {
        "value_loss": last_epoch / head.shape[0],
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


@struct.dataclass
class _Plan:
    """Minibatches of H networks that share E epochs of B rows.

    Attributes:
      order: in every epoch the rows of network 0, then those of network 1, ..., each in random order.
      first: where each network's rows begin in it.
      rows: how many each has.
      share: rows of a minibatch, M.
    """

    order: Int[Array, "E B"]
    first: Int[Array, " H"]
    rows: Int[Array, " H"]
    share: int = struct.field(pytree_node=False)

    @property
    def turns(self) -> Int[Array, " H"]:
        """Minibatches of each network, of all epochs."""
        return self.order.shape[0] * -(-self.rows // self.share)

    def minibatches(
        self, number: Int[Array, ""]
    ) -> tuple[Int[Array, " H"], Int[Array, "H M"], Float[Array, "H M"]]:
        """Of every network the minibatch `number`: its epoch, rows, and their weights, 0 beyond the network's last."""
        epochs, size = self.order.shape
        epoch, within = jnp.divmod(number, jnp.maximum(-(-self.rows // self.share), 1))
        place = within[:, None] * self.share + jnp.arange(self.share)[None]
        position = jnp.minimum(self.first[:, None] + place, size - 1)
        rows = self.order[jnp.minimum(epoch, epochs - 1)[:, None], position]
        return epoch, rows, (place < self.rows[:, None]).astype(jnp.float32)


def _plan(key: PRNGKeyArray, head: Int[Array, " B"], config: ValueConfig) -> _Plan:
    rows = jnp.sum(jax.nn.one_hot(head, config.networks, dtype=jnp.int32), axis=0)

    def epoch(epoch_key: PRNGKeyArray) -> Int[Array, " B"]:
        drawn = head + 0.5 * jax.random.uniform(epoch_key, head.shape)
        # What is not negative has the order of its bits.
        return grouped.argsort(jax.lax.bitcast_convert_type(drawn, jnp.uint32))

    order = jax.vmap(epoch)(jax.random.split(key, config.epochs))
    return _Plan(order, jnp.cumsum(rows) - rows, rows, min(config.minibatch_size, head.shape[0]))
