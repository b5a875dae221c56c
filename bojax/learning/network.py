"""A multilayer perceptron."""

from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float

from bojax.numerics.linalg import matmul


class Network(eqx.Module):
    """A multilayer perceptron: `equinox.nn.MLP` with arrays as its only leaves."""

    layers: tuple[eqx.nn.Linear, ...]  # linear layers, each with a bias
    # Activation function of the hidden units; the outputs are linear
    activation: Callable[[Array], Array] = eqx.field(static=True)

    def __call__(self, x: Float[Array, "I"]) -> Float[Array, "O"]:
        """The outputs for one input."""
        for number, layer in enumerate(self.layers):
            assert layer.bias is not None
            x = matmul(layer.weight, self.activation(x) if number else x) + layer.bias
        return x
