"""A lunar lander with noisy sensors (Lim, Tomlin and Sunberg, 2021)."""

from dataclasses import replace
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.numerics.linalg import full_precision
from bojax.problems import kalman
from bojax.problems.actions import Box
from bojax.problems.particles import Particles
from bojax.problems.pomdp.readings import GaussianReading, ReadingProblem
from bojax.results.outline import Outline

_LEAST_VARIANCE = 1e-8
"""Added to the variances of a Gaussian belief before it is drawn from."""


class PomdpLander(ReadingProblem):
    """A rigid body in a plane, with a main engine and a lateral thruster off the centre of mass.

    A state is (x, z, theta, v_x, v_z, omega). An action is the lateral force, the thrust and the offset of
    the lateral thruster. An observation is the range along the axis, the angular velocity and the
    horizontal velocity. The published code passes `initial_noise` as deviations to a distribution that takes
    variances; the settings have the deviations that follow.

    Settings: `bojax.problems.pomdp.settings.PomdpLander`.
    """

    time_step: Float[Array, ""]
    mass: Float[Array, ""]
    inertia: Float[Array, ""]
    gravity: Float[Array, ""]
    velocity_noise: Float[Array, "3"]
    sensor_noise: Float[Array, "3"]
    initial_mean: Float[Array, "6"]
    initial_noise: Float[Array, "6"]
    action_low: Float[Array, "3"]
    action_high: Float[Array, "3"]
    max_distance: Float[Array, ""]
    max_tilt: Float[Array, ""]
    landing_height: Float[Array, ""]
    crash_reward: Float[Array, ""]
    landing_reward: Float[Array, ""]
    step_reward: Float[Array, ""]
    braking_gain: Float[Array, ""]
    discount: Float[Array, ""]
    max_steps: int = eqx.field(static=True)
    belief_update: Literal["bootstrap", "gaussian"] = eqx.field(
        static=True, default="bootstrap", kw_only=True
    )

    @override
    def sketch(self, state: Float[Array, "6"]) -> dict[str, Float[Array, "2"]]:
        return {"lander": state[:2]}

    @override
    def outline(self) -> Outline:
        width, ground = self.max_distance, self.landing_height
        return Outline(border=(-width, ground, width, self.initial_mean[1] + 5.0))

    @property
    @override
    def actions(self) -> Box:
        return Box(self.action_low, self.action_high)

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "6"]:
        return self.initial_mean + self.initial_noise * jax.random.normal(key, (6,), self.initial_mean.dtype)

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "6"], action: Float[Array, "3"]
    ) -> tuple[Float[Array, "6"], Float[Array, ""], Bool[Array, ""]]:
        lateral, thrust, offset = action[0], action[1], action[2]
        cos, sin = jnp.cos(state[2]), jnp.sin(state[2])
        acceleration = jnp.stack(
            [
                (cos * lateral - sin * thrust) / self.mass,
                (cos * thrust + sin * lateral) / self.mass - self.gravity,
                -offset * lateral / self.inertia,
            ]
        )
        noise = self.velocity_noise * jax.random.normal(key, (3,), state.dtype)
        velocities = state[3:] + self.time_step * acceleration + noise
        next_state = jnp.concatenate([state[:3] + self.time_step * state[3:], velocities])
        crashed, landed = self._crashed(next_state), self._landed(next_state)
        paid = self.landing_reward - jnp.abs(next_state[0]) - next_state[4] ** 2
        reward = jnp.where(crashed, self.crash_reward, jnp.where(landed, paid, self.step_reward))
        return next_state, reward, crashed | landed

    @override
    def reading(self, action: Float[Array, "3"], next_state: Float[Array, "6"]) -> GaussianReading:
        distance = next_state[1] / jnp.cos(next_state[2])
        return GaussianReading(jnp.stack([distance, next_state[5], next_state[3]]), self.sensor_noise)

    @override
    @full_precision
    def filter(
        self,
        key: Key[Array, ""],
        belief: Particles,
        action: Float[Array, "3"],
        observation: Float[Array, "3"],
    ) -> tuple[Particles, Bool[Array, ""]]:
        """The bootstrap filter, or an extended Kalman filter whose belief is drawn anew at each step.

        Drawn particles may be terminal. The belief has collapsed if all of them are, or if one is not finite.
        """
        if self.belief_update == "bootstrap":
            return super().filter(key, belief, action, observation)
        step_key, draw_key = jax.random.split(key)
        silent = replace(self, velocity_noise=jnp.zeros_like(self.velocity_noise))

        def move(state: Float[Array, "6"]) -> Float[Array, "6"]:
            return silent.step(jax.random.clone(step_key), state, action)[0]

        def expect(state: Float[Array, "6"]) -> Float[Array, "3"]:
            return self.reading(action, state).mean

        transition, mean = jax.jacfwd(move)(belief.mean), move(belief.mean)
        noise = jnp.concatenate([jnp.zeros_like(self.velocity_noise), self.velocity_noise])
        covariance = transition @ belief.covariance @ transition.T + jnp.diag(noise**2)
        after = kalman.condition(
            kalman.Gaussian(mean, covariance),
            jax.jacfwd(expect)(mean),
            jnp.diag(self.sensor_noise**2),
            observation - expect(mean),
        )
        draws = jax.random.normal(draw_key, belief.states.shape, mean.dtype)
        # Without the floor, rounding to float32 might make a small variance negative.
        floor = _LEAST_VARIANCE * jnp.eye(mean.shape[0], dtype=mean.dtype)
        states = after.mean[None] + draws @ jnp.linalg.cholesky(after.covariance + floor).T
        terminal = jax.vmap(self._is_terminal)(states)
        has_collapsed = jnp.all(terminal) | ~jnp.all(jnp.isfinite(states))
        return Particles(states, belief.log_weights, terminal), has_collapsed

    def _is_terminal(self, state: Float[Array, "6"]) -> Bool[Array, ""]:
        return self._crashed(state) | self._landed(state)

    def _crashed(self, state: Float[Array, "6"]) -> Bool[Array, ""]:
        return (jnp.abs(state[0]) >= self.max_distance) | (jnp.abs(state[2]) >= self.max_tilt)

    def _landed(self, state: Float[Array, "6"]) -> Bool[Array, ""]:
        return state[1] <= self.landing_height
