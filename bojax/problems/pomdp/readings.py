"""Distributions of observations, and the state problems whose observations follow from where a step ends."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.problems.state_model import Action, Observation, State
from bojax.problems.state_space import StateProblem


class Reading(eqx.Module):
    """The distribution of an observation."""

    @abc.abstractmethod
    def sample(self, key: Key[Array, ""]) -> Observation:
        """An observation."""

    @abc.abstractmethod
    def log_density(self, observation: Observation) -> Float[Array, ""]:
        """Logarithm of the density, or of the probability, of an observation."""


class GaussianReading(Reading):
    """Independent Gaussian numbers."""

    mean: Float[Array, "O"]
    noise: Float[Array, "*O"]  # standard deviations, or one for all

    @override
    def sample(self, key: Key[Array, ""]) -> Observation:
        return self.mean + self.noise * jax.random.normal(key, self.mean.shape, self.mean.dtype)

    @override
    def log_density(self, observation: Observation) -> Float[Array, ""]:
        return jnp.sum(norm.logpdf(observation, self.mean, self.noise))


class BinaryReading(Reading):
    """Independent answers, 0 or 1, each of which is right with the same probability."""

    truth: Float[Array, "O"]  # the right answers
    accuracy: Float[Array, ""]  # probability that an answer is right

    @override
    def sample(self, key: Key[Array, ""]) -> Observation:
        is_right = jax.random.bernoulli(key, self.accuracy, self.truth.shape)
        return jnp.where(is_right, self.truth, 1.0 - self.truth)

    @override
    def log_density(self, observation: Observation) -> Float[Array, ""]:
        is_right = observation == self.truth
        return jnp.sum(jnp.log(jnp.where(is_right, self.accuracy, 1.0 - self.accuracy)))


class Beams(Reading):
    """A range finder with beams all around (VDP Tag and Sub Hunt): independent Gaussian readings.

    There is one distribution for the target's beam, and one for all others.
    """

    index: Int[Array, ""]  # the target's beam
    mean: Float[Array, ""]  # mean of its reading
    noise: Float[Array, ""]  # standard deviation of its reading
    other_mean: Float[Array, ""]  # mean of any other reading
    other_noise: Float[Array, ""]  # standard deviation of any other reading
    num: int = eqx.field(static=True)  # number of beams

    @override
    def sample(self, key: Key[Array, ""]) -> Observation:
        is_target = jnp.arange(self.num, dtype=jnp.int32) == self.index
        mean = jnp.where(is_target, self.mean, self.other_mean)
        noise = jnp.where(is_target, self.noise, self.other_noise)
        return mean + noise * jax.random.normal(key, (self.num,), mean.dtype)

    @override
    def log_density(self, observation: Observation) -> Float[Array, ""]:
        # The sum over other beams is the same for all particles, which thus evaluate one beam each.
        others = norm.logpdf(observation, self.other_mean, self.other_noise)
        reading = observation[self.index]
        instead = norm.logpdf(reading, self.other_mean, self.other_noise)
        return jnp.sum(others) - instead + norm.logpdf(reading, self.mean, self.noise)


def beam_towards(offset: Float[Array, "2"], num: int) -> Int[Array, ""]:
    """The beam that covers a direction: beam i covers angles in (i, i + 1] turns / num, and 0 is a turn."""
    angle = jnp.arctan2(offset[1], offset[0])
    angle = jnp.where(angle <= 0.0, angle + 2.0 * jnp.pi, angle)
    return jnp.clip(jnp.ceil(num * (angle / (2.0 * jnp.pi))).astype(jnp.int32) - 1, 0, num - 1)


def length_of(vector: Float[Array, "2"]) -> Float[Array, ""]:
    """Length of a vector, without a reduction."""
    return jnp.sqrt(vector[0] ** 2 + vector[1] ** 2)


class ReadingProblem(StateProblem):
    """A state problem whose observation depends on the action and on the next state alone."""

    @abc.abstractmethod
    def reading(self, action: Action, next_state: State) -> Reading:
        """The distribution of the observation after a step."""

    @override
    def observe(self, key: Key[Array, ""], state: State, action: Action, next_state: State) -> Observation:
        return self.reading(action, next_state).sample(key)

    @override
    def log_likelihood(
        self, observation: Observation, state: State, action: Action, next_state: State
    ) -> Float[Array, ""]:
        return self.reading(action, next_state).log_density(observation)
