"""Distributions of observations, and the state problems whose observations follow from where a step ends."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.problems.state_space import StateProblem


class Reading(eqx.Module):
    """The distribution of an observation."""

    @abc.abstractmethod
    def sample(self, key: Key[Array, ""]) -> Float[Array, "O"]:
        """An observation."""

    @abc.abstractmethod
    def log_density(self, observation: Float[Array, "O"]) -> Float[Array, ""]:
        """Logarithm of the density, or of the probability, of an observation."""


class GaussianReading(Reading):
    """Independent Gaussian numbers."""

    mean: Float[Array, "O"]
    noise: Float[Array, "*O"]  # standard deviations, or one for all

    @override
    def sample(self, key: Key[Array, ""]) -> Float[Array, "O"]:
        return self.mean + self.noise * jax.random.normal(key, self.mean.shape, self.mean.dtype)

    @override
    def log_density(self, observation: Float[Array, "O"]) -> Float[Array, ""]:
        return jnp.sum(norm.logpdf(observation, self.mean, self.noise))


class BinaryReading(Reading):
    """Independent answers, 0 or 1, each of which is right with the same probability."""

    truth: Float[Array, "O"]  # the right answers
    accuracy: Float[Array, ""]  # probability that an answer is right

    @override
    def sample(self, key: Key[Array, ""]) -> Float[Array, "O"]:
        is_right = jax.random.bernoulli(key, self.accuracy, self.truth.shape)
        return jnp.where(is_right, self.truth, 1.0 - self.truth)

    @override
    def log_density(self, observation: Float[Array, "O"]) -> Float[Array, ""]:
        is_right = observation == self.truth
        return jnp.sum(jnp.log(jnp.where(is_right, self.accuracy, 1.0 - self.accuracy)))


class ReadingProblem(StateProblem):
    """A state problem whose observation depends on the action and on the next state alone."""

    @abc.abstractmethod
    def reading(self, action: Float[Array, "K"], next_state: Float[Array, "D"]) -> Reading:
        """The distribution of the observation after a step."""

    @override
    def observe(
        self,
        key: Key[Array, ""],
        state: Float[Array, "D"],
        action: Float[Array, "K"],
        next_state: Float[Array, "D"],
    ) -> Float[Array, "O"]:
        return self.reading(action, next_state).sample(key)

    @override
    def log_likelihood(
        self,
        observation: Float[Array, "O"],
        state: Float[Array, "D"],
        action: Float[Array, "K"],
        next_state: Float[Array, "D"],
    ) -> Float[Array, ""]:
        return self.reading(action, next_state).log_density(observation)
