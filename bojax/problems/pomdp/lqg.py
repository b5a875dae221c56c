"""A linear problem with quadratic costs and Gaussian noise, solved exactly (Lim, Tomlin, Sunberg, 2021)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.numerics.linalg import full_precision
from bojax.problems.actions import Box
from bojax.problems.kalman import Gaussian, LinearGaussian
from bojax.problems.pomdp.readings import GaussianReading, ReadingProblem


class Lqg(ReadingProblem):
    """Positions x with x' = A x + B a + noise, o = C x' + noise, and cost x'Q x + a'R a at each step.

    A state is x, then the number of steps taken. The episode ends after `max_steps` steps; the last one costs
    x'Q x of the final position on top.

    Settings: `bojax.problems.pomdp.settings.Lqg`.
    """

    transition: Float[Array, "X X"]
    control: Float[Array, "X K"]
    sensor: Float[Array, "O X"]
    state_cost: Float[Array, "X X"]
    action_cost: Float[Array, "K K"]
    process_noise: Float[Array, ""]
    sensor_noise: Float[Array, ""]
    initial_mean: Float[Array, "X"]
    initial_noise: Float[Array, ""]
    action_bound: Float[Array, ""]
    discount: Float[Array, ""]
    max_steps: int = eqx.field(static=True)

    @property
    @override
    def actions(self) -> Box:
        bound = jnp.full(self.control.shape[1], self.action_bound)
        return Box(-bound, bound)

    @property
    def model(self) -> LinearGaussian:
        """The model of the positions, for a Kalman filter."""
        process = self.process_noise**2 * jnp.eye(self.transition.shape[0], dtype=self.discount.dtype)
        sensor = self.sensor_noise**2 * jnp.eye(self.sensor.shape[0], dtype=self.discount.dtype)
        return LinearGaussian(self.transition, self.control, self.sensor, process, sensor)

    @property
    def gaussian_prior(self) -> Gaussian:
        """The initial belief of the position."""
        eye = jnp.eye(self.initial_mean.shape[0], dtype=self.discount.dtype)
        return Gaussian(self.initial_mean, self.initial_noise**2 * eye)

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "D"]:
        mean = self.initial_mean
        start = mean + self.initial_noise * jax.random.normal(key, mean.shape, mean.dtype)
        return jnp.append(start, 0.0)

    @override
    @full_precision
    def step(
        self, key: Key[Array, ""], state: Float[Array, "D"], action: Float[Array, "K"]
    ) -> tuple[Float[Array, "D"], Float[Array, ""], Bool[Array, ""]]:
        position, time = state[:-1], state[-1] + 1.0
        noise = self.process_noise * jax.random.normal(key, position.shape, position.dtype)
        moved = self.transition @ position + self.control @ action + noise
        ended = time >= self.max_steps
        cost = position @ self.state_cost @ position + action @ self.action_cost @ action
        cost = cost + jnp.where(ended, moved @ self.state_cost @ moved, 0.0)
        return jnp.append(moved, time), -cost, ended

    @override
    @full_precision
    def reading(self, action: Float[Array, "K"], next_state: Float[Array, "D"]) -> GaussianReading:
        return GaussianReading(self.sensor @ next_state[:-1], self.sensor_noise)
