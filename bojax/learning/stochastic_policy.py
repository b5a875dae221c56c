"""A stochastic policy: a network from the observation to a distribution of actions."""

import abc
import math
from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.envs.spaces import Discrete, Space
from bojax.learning.network import Network


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
    """Independent Gaussian components."""

    mean: Float[Array, "A"]
    log_deviation: Float[Array, "A"]  # logarithms of the standard deviations

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
    """A finite number of actions."""

    logits: Float[Array, "J"]  # logarithms of the probabilities, up to a constant

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

    def __call__(self, inputs: Float[Array, "I"]) -> ActionDistribution:
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
