"""The multi-layer perceptron against one written out by hand."""

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from flax.linen.initializers import orthogonal

from mpge_jax.learning.networks import MLP


def test_forward_pass_by_hand():
    params = {
        "params": {
            "Dense_0": {"kernel": jnp.array([[1.0, -1.0], [0.5, 2.0]]), "bias": jnp.array([0.0, 1.0])},
            "Dense_1": {"kernel": jnp.array([[2.0], [-3.0]]), "bias": jnp.array([0.25])},
        }
    }
    # [2, 1] -> relu([2 + 0.5, -2 + 2 + 1]) = [2.5, 1] -> 5 - 3 + 0.25 = 2.25: the last layer is linear.
    np.testing.assert_allclose(MLP((2, 1)).apply(params, jnp.array([2.0, 1.0])), [2.25])
    # [-2, -1] -> relu([-2.5, 1]) = [0, 1] -> -3 + 0.25
    np.testing.assert_allclose(MLP((2, 1)).apply(params, jnp.array([-2.0, -1.0])), [-2.75])
    tanh = MLP((2, 1), nn.tanh).apply(params, jnp.array([2.0, 1.0]))
    np.testing.assert_allclose(tanh, [2 * np.tanh(2.5) - 3 * np.tanh(1.0) + 0.25], rtol=1e-5)


def test_leading_axes_are_free():
    network = MLP((8, 3))
    params = network.init(jax.random.key(0), jnp.zeros(4))
    x = jax.random.normal(jax.random.key(1), (5, 2, 4))
    assert network.apply(params, x).shape == (5, 2, 3)
    np.testing.assert_allclose(
        network.apply(params, x)[3, 1], network.apply(params, x[3, 1]), rtol=1e-5, atol=1e-6
    )


def test_initialisers():
    network = MLP((16, 16, 4), nn.tanh, hidden_init=orthogonal(2.0**0.5), final_init=orthogonal(0.01))
    layers = network.init(jax.random.key(0), jnp.zeros(16))["params"]
    for name, gain in (("Dense_0", 2.0**0.5), ("Dense_1", 2.0**0.5), ("Dense_2", 0.01)):
        kernel = np.asarray(layers[name]["kernel"])
        np.testing.assert_allclose(kernel.T @ kernel, gain**2 * np.eye(kernel.shape[1]), atol=1e-5 * gain)
        np.testing.assert_array_equal(layers[name]["bias"], np.zeros(kernel.shape[1]))


def test_final_layer_takes_the_hidden_initialiser_by_default():
    layers = MLP((4, 4), hidden_init=orthogonal(3.0)).init(jax.random.key(0), jnp.zeros(4))["params"]
    kernel = np.asarray(layers["Dense_1"]["kernel"])
    np.testing.assert_allclose(kernel @ kernel.T, 9.0 * np.eye(4), atol=1e-4)
