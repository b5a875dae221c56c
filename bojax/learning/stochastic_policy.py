"""A stochastic policy: a network from the observation to a distribution of actions."""

import abc
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.envs.spaces import Discrete, Space
from bojax.numerics.linalg import matmul


class ActionDistribution(eqx.Module):
    """A distribution of actions: vectors, or the numbers of discrete actions."""

    @abc.abstractmethod
    def sample(self, key: Key[Array, ""]) -> Array:
        """A random action."""

    @abc.abstractmethod
    def mode(self) -> Array:
        """The most probable action."""

    @abc.abstractmethod
    def log_probability(self, action: Array) -> Float[Array, ""]:
        """Logarithm of the density or probability of an action."""

    @abc.abstractmethod
    def kl(self, other: "ActionDistribution") -> Float[Array, ""]:
        """KL divergence of this distribution from another one of its class."""


class Gaussian(ActionDistribution):
    """Independent Gaussian components.

    Attributes:
        mean: Means.
        log_deviation: Logarithms of the standard deviations.
    """

    mean: Float[Array, "A"]
    log_deviation: Float[Array, "A"]

    @override
    def sample(self, key: Key[Array, ""]) -> Float[Array, "A"]:
        return self.mean + jnp.exp(self.log_deviation) * jax.random.normal(
            key, self.mean.shape, self.mean.dtype
        )

    @override
    def mode(self) -> Float[Array, "A"]:
        return self.mean

    @override
    def log_probability(self, action: Float[Array, "A"]) -> Float[Array, ""]:
        errors = (action - self.mean) * jnp.exp(-self.log_deviation)
        return -jnp.sum(0.5 * errors**2 + self.log_deviation + 0.5 * math.log(2.0 * math.pi))

    @override
    def kl(self, other: ActionDistribution) -> Float[Array, ""]:
        assert isinstance(other, Gaussian)
        shift = self.log_deviation - other.log_deviation
        errors = (self.mean - other.mean) * jnp.exp(-other.log_deviation)
        return jnp.sum(0.5 * (jnp.exp(2.0 * shift) + errors**2 - 1.0) - shift)


class Categorical(ActionDistribution):
    """A finite number of actions.

    Attributes:
        logits: Logarithms of the probabilities, up to a constant.
    """

    logits: Float[Array, "J"]

    @override
    def sample(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return jax.random.categorical(key, self.logits).astype(jnp.int32)

    @override
    def mode(self) -> Int[Array, ""]:
        return jnp.argmax(self.logits).astype(jnp.int32)

    @override
    def log_probability(self, action: Int[Array, ""]) -> Float[Array, ""]:
        return jax.nn.log_softmax(self.logits)[action]

    @override
    def kl(self, other: ActionDistribution) -> Float[Array, ""]:
        assert isinstance(other, Categorical)
        own, others = jax.nn.log_softmax(self.logits), jax.nn.log_softmax(other.logits)
        return jnp.sum(jnp.exp(own) * (own - others))


class Linear(eqx.Module):
    """A linear layer.

    Attributes:
        weights: Weights.
        biases: Biases.
    """

    weights: Float[Array, "I O"]
    biases: Float[Array, "O"]


class PolicyNetwork(eqx.Module):
    """Layers of tanh units that give the mean of a Gaussian, or the logits of discrete actions.

    Every leaf is a parameter. The deviation of the Gaussian does not depend on the observation.

    Attributes:
        layers: The layers; the last one is linear.
        log_deviation: Logarithms of the standard deviations; None for discrete actions.
    """

    layers: tuple[Linear, ...]
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

        Args:
            key: Random key.
            num_inputs: Number of inputs.
            hidden: Number of units of each hidden layer.
            actions: Space of actions.
            deviation: Standard deviation of the Gaussian.
        """
        num_outputs = actions.num if isinstance(actions, Discrete) else actions.num_dims
        sizes = (num_inputs, *hidden, num_outputs)
        keys, dtype = jax.random.split(key, len(sizes) - 1), deviation.dtype
        draw = jax.nn.initializers.glorot_uniform()
        layers = tuple(
            Linear(draw(key, shape, dtype), jnp.zeros(shape[1:], dtype))
            for key, shape in zip(keys, zip(sizes[:-1], sizes[1:], strict=True), strict=True)
        )
        if isinstance(actions, Discrete):
            return cls(layers, None)
        return cls(layers, jnp.broadcast_to(jnp.log(deviation), (num_outputs,)))

    def __call__(self, inputs: Float[Array, "I"]) -> ActionDistribution:
        """The distribution of actions after an observation."""
        *hidden, last = self.layers
        for layer in hidden:
            inputs = jnp.tanh(matmul(inputs, layer.weights) + layer.biases)
        outputs = matmul(inputs, last.weights) + last.biases
        if self.log_deviation is None:
            return Categorical(outputs)
        return Gaussian(outputs, self.log_deviation)
