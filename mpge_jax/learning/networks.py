"""Multi-layer perceptrons, the only network shape in this project."""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax.linen.initializers import Initializer, lecun_normal, zeros_init


@cache
def orthogonal(gain: float) -> Initializer:
    """Kernels `[in, out]` whose rows or columns (the fewer) are orthogonal and of norm `gain`.

    The polar factor of a Gaussian matrix, by Newton-Schulz iteration. Its distribution is the one that QR gives, but QR
    under vmap calls LAPACK in a way that waits for ever on JAX's CPU backend where two layers meet on two cores.
    """

    def init(key: jax.Array, shape: Sequence[int], dtype: Any = jnp.float32, **_: Any) -> jax.Array:
        rows, columns = shape
        x = jax.random.normal(key, (max(rows, columns), min(rows, columns)), dtype)
        # The Frobenius norm bounds the spectral norm, which the iteration needs below sqrt(3).
        x = x / jnp.linalg.norm(x)
        # Each step multiplies a small singular value by 1.5: enough for 1e-5 of the largest, and then quadratic.
        x = jax.lax.fori_loop(0, 48, lambda _, x: 1.5 * x - 0.5 * x @ (x.T @ x), x)
        return gain * (x if rows >= columns else x.T)

    return init


@partial(jax.jit, static_argnums=(0, 2))
def initial(network: nn.Module, key: jax.Array, inputs: int) -> Any:
    """Fresh parameters of a `network` of `inputs` numbers. `key` is consumed.

    One program for each network: operation by operation, compiling it takes twenty times as long.
    """
    return network.init(key, jnp.zeros((1, inputs)))


def widths(params: Any) -> tuple[int, ...]:
    """Outputs of every layer of an `MLP` with these parameters, of all of a stack `[..., in, out]` alike."""
    layers = params["params"]
    return tuple(layers[f"Dense_{i}"]["bias"].shape[-1] for i in range(len(layers)))


class MLP(nn.Module):
    """A multi-layer perceptron, `[..., in] -> [..., sizes[-1]]`, linear at its last layer.

    Attributes:
      sizes: width of every layer; the last is the output.
      activation: applied after every layer but the last.
      hidden_init: kernel initialiser of the hidden layers.
      final_init: kernel initialiser of the last layer; `hidden_init` where None.
    """

    sizes: Sequence[int]
    activation: Callable[[jax.Array], jax.Array] = nn.relu
    hidden_init: Initializer = lecun_normal()
    final_init: Initializer | None = None

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        for size in self.sizes[:-1]:
            x = self.activation(nn.Dense(size, kernel_init=self.hidden_init, bias_init=zeros_init())(x))
        final_init = self.hidden_init if self.final_init is None else self.final_init
        return nn.Dense(self.sizes[-1], kernel_init=final_init, bias_init=zeros_init())(x)
