"""The action transformer pi_g(delta | s, a): with the actions it makes, the source moves as the target would.

A Gaussian policy over a residual, `a~ = clip(a + clip(delta))`, as in GARAT (Desai et al., NeurIPS 2020) and
MPGE (IJCAI 2022). Two steps are kept apart: `sample` draws delta, whose log-probability is that of the
unclipped draw, and `transform` applies it.
"""

from dataclasses import dataclass

import flax.linen as nn
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, ArrayLike, Float, PRNGKeyArray

from mpge_jax.learning.distributions import gaussian_log_prob, gaussian_sample
from mpge_jax.learning.networks import MLP, initial, orthogonal, widths
from mpge_jax.learning.policy_gradient import Params


@dataclass(frozen=True)
class TransformerConfig:
    """Shape and start of an action transformer.

    Attributes:
      hidden: width of each tanh layer.
      init_log_std: start of the log standard deviation of delta, in action units; 0 in the paper.
    """

    hidden: tuple[int, ...] = (64, 64)
    init_log_std: float = 0.0

    def __post_init__(self) -> None:
        if any(size < 1 for size in self.hidden):
            raise ValueError(
                f"TransformerConfig: every hidden layer needs a positive width, got {self.hidden}."
            )


class Transformer(struct.PyTreeNode):
    """An action transformer.

    Attributes:
      params: what learning changes: `{"mean": network, "log_std": [A]}`.
      input_mean: subtracted from (s, a); zeros in the paper, which feeds (s, a) raw.
      input_std: divides the difference; ones in the paper.
    """

    params: Params
    input_mean: Float[Array, "*n I"]
    input_std: Float[Array, "*n I"]


def init(
    key: PRNGKeyArray, observation_size: int, action_size: int, config: TransformerConfig
) -> Transformer:
    """A transformer whose mean residual is nearly zero, with raw inputs. `key` is consumed."""
    network = _network((*config.hidden, action_size))
    inputs = observation_size + action_size
    return Transformer(
        params={
            "mean": initial(network, key, inputs),
            "log_std": jnp.full(action_size, config.init_log_std, jnp.float32),
        },
        input_mean=jnp.zeros(inputs),
        input_std=jnp.ones(inputs),
    )


def network_inputs(
    transformer: Transformer, observation: Float[Array, "*n O"], action: Float[Array, "*n A"]
) -> Float[Array, "*n O+A"]:
    """The network's view of an `observation` and a policy's `action`.

    Raises:
      ValueError: their sizes are not those the transformer was made for.
    """
    pair = jnp.concatenate([observation, action], axis=-1)
    if pair.shape[-1] != transformer.input_mean.shape[-1]:
        raise ValueError(
            f"This transformer takes observation and action of {transformer.input_mean.shape[-1]} numbers "
            f"together, got {observation.shape[-1]} + {action.shape[-1]}; was it made for another task?"
        )
    shape = (1,) * (pair.ndim - 1) + transformer.input_mean.shape
    return (pair - transformer.input_mean.reshape(shape)) / transformer.input_std.reshape(shape)


def apply(params: Params, inputs: Float[Array, "*n I"]) -> tuple[Float[Array, "*n A"], Float[Array, "*n A"]]:
    """`(mean, log_std)` of delta: the `distribution` for `trpo.update` and `ppo.update`."""
    mean = _network(widths(params["mean"])).apply(params["mean"], inputs)
    return mean, jnp.broadcast_to(params["log_std"], mean.shape)


def distribution(
    transformer: Transformer, observation: Float[Array, "*n O"], action: Float[Array, "*n A"]
) -> tuple[Float[Array, "*n A"], Float[Array, "*n A"]]:
    """`(mean, log_std)` of delta."""
    return apply(transformer.params, network_inputs(transformer, observation, action))


def sample(
    transformer: Transformer,
    key: PRNGKeyArray,
    observation: Float[Array, "*n O"],
    action: Float[Array, "*n A"],
) -> tuple[Float[Array, "*n A"], Float[Array, "*n"]]:
    """A residual as drawn, before any clipping. `key` is consumed.

    Returns:
      `(delta, log_prob)`.
    """
    mean, log_std = distribution(transformer, observation, action)
    delta = gaussian_sample(key, mean, log_std)
    return delta, gaussian_log_prob(delta, mean, log_std)


def transform(
    delta: Float[Array, "*n A"],
    action: Float[Array, "*n A"],
    low: Float[ArrayLike, " A"],
    high: Float[ArrayLike, " A"],
) -> Float[Array, "*n A"]:
    """The transformed action: delta is clipped to +-(high - low), then the sum to `[low, high]`.

    The two clips differ only where `action` itself lies outside `[low, high]`.
    """
    low, high = _match(low, delta), _match(high, delta)
    span = high - low
    return jnp.clip(action + jnp.clip(delta, -span, span), low, high)


def deterministic(
    transformer: Transformer,
    observation: Float[Array, "*n O"],
    action: Float[Array, "*n A"],
    low: Float[ArrayLike, " A"],
    high: Float[ArrayLike, " A"],
) -> Float[Array, "*n A"]:
    """The transformed action at the mean residual: so agents are trained and pi_g is judged."""
    mean, _ = distribution(transformer, observation, action)
    return transform(mean, action, low, high)


def _match(bound: Float[ArrayLike, " A"], like: Float[Array, "*n A"]) -> Float[Array, "*n A"]:
    bound = jnp.asarray(bound, like.dtype)
    return jnp.broadcast_to(bound.reshape((1,) * (like.ndim - bound.ndim) + bound.shape), like.shape)


def _network(sizes: tuple[int, ...]) -> nn.Module:
    return MLP(sizes, nn.tanh, hidden_init=orthogonal(2.0**0.5), final_init=orthogonal(0.01))
