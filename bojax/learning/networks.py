"""Multilayer perceptrons, and stochastic policies: from the observation to a distribution of actions."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from bojax.envs.spaces import Discrete, Space
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


class Gaussian(eqx.Module):
    """Actions of independent Gaussian components."""

    mean: Float[Array, "A"]
    log_deviation: Float[Array, "A"]  # logarithms of the standard deviations

    def sample(self, key: Key[Array, ""]) -> Float[Array, "A"]:
        """A random action."""
        return self.mean + jnp.exp(self.log_deviation) * jax.random.normal(
            key, self.mean.shape, self.mean.dtype
        )

    def mode(self) -> Float[Array, "A"]:
        """The most probable action."""
        return self.mean

    def log_probability(self, action: Float[Array, "A"]) -> Float[Array, ""]:
        """Logarithm of the density of an action."""
        errors = (action - self.mean) * jnp.exp(-self.log_deviation)
        return -jnp.sum(0.5 * errors**2 + self.log_deviation + 0.5 * math.log(2.0 * math.pi))

    def kl(self, other: Any) -> Float[Array, ""]:
        """KL divergence of this distribution from another Gaussian one."""
        shift = self.log_deviation - other.log_deviation
        errors = (self.mean - other.mean) * jnp.exp(-other.log_deviation)
        return jnp.sum(0.5 * (jnp.exp(2.0 * shift) + errors**2 - 1.0) - shift)


class Categorical(eqx.Module):
    """A finite number of actions."""

    logits: Float[Array, "J"]  # logarithms of the probabilities, up to a constant

    def sample(self, key: Key[Array, ""]) -> Int[Array, ""]:
        """A random action."""
        return jax.random.categorical(key, self.logits).astype(jnp.int32)

    def mode(self) -> Int[Array, ""]:
        """The most probable action."""
        return jnp.argmax(self.logits).astype(jnp.int32)

    def log_probability(self, action: Int[Array, ""]) -> Float[Array, ""]:
        """Logarithm of the probability of an action."""
        return jax.nn.log_softmax(self.logits)[action]

    def kl(self, other: Any) -> Float[Array, ""]:
        """KL divergence of this distribution from another one of as many actions."""
        own, others = jax.nn.log_softmax(self.logits), jax.nn.log_softmax(other.logits)
        return jnp.sum(jnp.exp(own) * (own - others))


class PolicyNetwork(eqx.Module):
    """Layers of tanh units whose outputs are the mean of a Gaussian, or the logits of discrete actions.

    Every leaf is a parameter. The deviation of the Gaussian does not depend on the observation.
    """

    network: Network
    # Logarithms of the standard deviations; None for discrete actions
    log_deviation: Float[Array, "A"] | None

    @classmethod
    def draw(
        cls,
        key: Key[Array, ""],
        num_inputs: int,
        hidden: Sequence[int],
        actions: Space,
        deviation: Float[Array, ""],
    ) -> "PolicyNetwork":
        """A network with weights drawn uniformly (Glorot and Bengio 2010) and biases of 0.

        `hidden` is the number of units of each hidden layer, `deviation` belongs to the Gaussian.
        """
        sizes = (num_inputs, *hidden, actions.num_units)
        keys = jax.random.split(key, len(sizes) - 1)
        draw = partial(_layer, deviation.dtype)
        network = Network(tuple(map(draw, keys, sizes[:-1], sizes[1:])), jnp.tanh)
        if isinstance(actions, Discrete):
            return cls(network, None)
        return cls(network, jnp.broadcast_to(jnp.log(deviation), sizes[-1:]))

    def __call__(self, inputs: Float[Array, "I"]) -> Gaussian | Categorical:
        """The distribution of actions after an observation."""
        outputs = self.network(inputs)
        if self.log_deviation is None:
            return Categorical(outputs)
        return Gaussian(outputs, self.log_deviation)


def _layer(dtype: jnp.dtype, key: Key[Array, ""], num_inputs: int, num_outputs: int) -> eqx.nn.Linear:
    layer = eqx.nn.Linear(num_inputs, num_outputs, dtype=dtype, key=jax.random.key(0))  # replaced below
    weight = jax.nn.initializers.glorot_uniform()(key, (num_inputs, num_outputs), dtype).T
    values = weight, jnp.zeros((num_outputs,), dtype)
    return eqx.tree_at(lambda layer: (layer.weight, layer.bias), layer, values)
