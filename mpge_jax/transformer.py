"""The action transformer pi_g(delta | s, a): with the actions it makes, the source moves as the target would.

A Gaussian policy over a residual, `a~ = clip(a + clip(delta))`, as in GARAT (Desai et al., NeurIPS 2020) and
MPGE (IJCAI 2022). Two steps are kept apart: `sample` draws delta, whose log-probability is that of the
unclipped draw, and `transform` applies it.
"""

from dataclasses import dataclass

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax import struct

from mpge_jax.distributions import gaussian_log_prob, gaussian_sample
from mpge_jax.networks import MLP, orthogonal
from mpge_jax.policy_gradient import Params


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
      input_mean: subtracted from (s, a), `[O + A]`; zeros in the paper, which feeds (s, a) raw.
      input_std: divides the difference, `[O + A]`; ones in the paper.
    """

    params: Params
    input_mean: jax.Array
    input_std: jax.Array


def init(key: jax.Array, observation_size: int, action_size: int, config: TransformerConfig) -> Transformer:
    """A transformer whose mean residual is nearly zero, with raw inputs. `key` is consumed."""
    network = _network((*config.hidden, action_size))
    inputs = observation_size + action_size
    return Transformer(
        params={
            "mean": network.init(key, jnp.zeros((1, inputs))),
            "log_std": jnp.full(action_size, config.init_log_std, jnp.float32),
        },
        input_mean=jnp.zeros(inputs),
        input_std=jnp.ones(inputs),
    )


def network_inputs(transformer: Transformer, observation: jax.Array, action: jax.Array) -> jax.Array:
    """The network's view, `[..., O + A]`, of an `observation` `[..., O]` and a policy's `action` `[..., A]`.

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


def apply(params: Params, inputs: jax.Array) -> tuple[jax.Array, jax.Array]:
    """`(mean, log_std)` of delta, `[..., A]` each: the `distribution` for `trpo.update` and `ppo.update`."""
    layers = params["mean"]["params"]
    sizes = tuple(layers[f"Dense_{i}"]["bias"].shape[-1] for i in range(len(layers)))
    mean = _network(sizes).apply(params["mean"], inputs)
    return mean, jnp.broadcast_to(params["log_std"], mean.shape)


def distribution(
    transformer: Transformer, observation: jax.Array, action: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """`(mean, log_std)` of delta, `[..., A]` each."""
    return apply(transformer.params, network_inputs(transformer, observation, action))


def sample(
    transformer: Transformer, key: jax.Array, observation: jax.Array, action: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """A residual as drawn, before any clipping. `key` is consumed.

    Returns:
      `(delta [..., A], log_prob [...])`.
    """
    mean, log_std = distribution(transformer, observation, action)
    delta = gaussian_sample(key, mean, log_std)
    return delta, gaussian_log_prob(delta, mean, log_std)


def transform(delta: jax.Array, action: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """The transformed action `[..., A]`: delta is clipped to +-(high - low), then the sum to `[low, high]`.

    The two clips differ only where `action` itself lies outside `[low, high]`.
    """
    low, high = _match(low, delta), _match(high, delta)
    span = high - low
    return jnp.clip(action + jnp.clip(delta, -span, span), low, high)


def deterministic(
    transformer: Transformer, observation: jax.Array, action: jax.Array, low: jax.Array, high: jax.Array
) -> jax.Array:
    """The transformed action `[..., A]` at the mean residual: so agents are trained and pi_g is judged."""
    mean, _ = distribution(transformer, observation, action)
    return transform(mean, action, low, high)


def _match(bound: jax.Array, like: jax.Array) -> jax.Array:
    bound = jnp.asarray(bound, like.dtype)
    return jnp.broadcast_to(bound.reshape((1,) * (like.ndim - bound.ndim) + bound.shape), like.shape)


def _network(sizes: tuple[int, ...]) -> nn.Module:
    return MLP(sizes, nn.tanh, hidden_init=orthogonal(2.0**0.5), final_init=orthogonal(0.01))
