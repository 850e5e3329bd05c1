"""Multi-layer perceptrons, the only network shape in this project."""

from collections.abc import Callable, Sequence

import flax.linen as nn
import jax
from flax.linen.initializers import Initializer, lecun_normal, zeros_init


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
