"""Swing a pendulum up with a motor too weak to lift it (thesis, p. 107): Gym's Pendulum with a goal."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.control import ControlStep, ControlTask, symmetric
from bojax.envs.spaces import Box
from bojax.numerics.angles import wrap_to_pi


class SinglePendulum(ControlTask):
    """A rod on a driven joint; its state is the angle from upright, in radians, and the angular velocity.

    The goal is to be upright within `goal_angle`, at any speed (p. 107: 0.05 rad). The author's runs
    test cos > 0.95 and |sin| < 0.05 instead, which is |angle| < 0.05002: the same goal. The classic reward
    is Gym's, `-(angle^2 + 0.1 velocity^2 + 0.001 torque^2)` of the state before the step. As in
    the author's code, a step to the goal pays 0 and ends the episode; in Gym no step ends it
    (`classic_ends_at_goal: false`).

    As in Gym, an episode begins at any angle, with a velocity uniform in [-1, 1].

    Settings: `bojax.envs.settings.SinglePendulum`.
    """

    goal_angle: Float[Array, ""]
    gravity: Float[Array, ""]
    mass: Float[Array, ""]
    length: Float[Array, ""]
    max_torque: Float[Array, ""]
    max_speed: Float[Array, ""]
    time_step: Float[Array, ""]
    max_steps: int = eqx.field(static=True)
    classic_ends_at_goal: Bool[Array, ""] = eqx.field(converter=jnp.asarray)

    @property
    @override
    def observation_space(self) -> Box:
        """Cosine and sine of the angle, and the angular velocity in rad/s."""
        one = jnp.ones_like(self.max_speed)
        return symmetric(one, one, self.max_speed)

    @property
    @override
    def action_space(self) -> Box:
        """The torque, in N m."""
        return symmetric(self.max_torque)

    @override
    def reset(self, key: Key[Array, ""]) -> Float[Array, "2"]:
        high = jnp.asarray([jnp.pi, 1.0], self.max_speed.dtype)
        return jax.random.uniform(key, (2,), high.dtype, -high, high)

    @override
    def observe(self, state: Float[Array, "2"]) -> Float[Array, "3"]:
        return jnp.stack([jnp.cos(state[0]), jnp.sin(state[0]), state[1]])

    @override
    def advance(
        self, key: Key[Array, ""], state: Float[Array, "2"], action: Float[Array, "1"]
    ) -> Float[Array, "2"]:
        """One semi-implicit Euler step, as in Gym."""
        angle, speed = state
        (torque,) = action
        weight = 1.5 * self.gravity / self.length * jnp.sin(angle)
        speed = speed + (weight + 3.0 / (self.mass * self.length**2) * torque) * self.time_step
        speed = jnp.clip(speed, -self.max_speed, self.max_speed)
        return jnp.stack([wrap_to_pi(angle + speed * self.time_step), speed])

    @override
    def is_goal(self, state: Float[Array, "2"]) -> Bool[Array, ""]:
        return jnp.abs(wrap_to_pi(state[0])) < self.goal_angle

    @override
    def classic(self, step: ControlStep) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        cost = wrap_to_pi(step.state[0]) ** 2 + 0.1 * step.state[1] ** 2 + 0.001 * step.action[0] ** 2
        ends = step.success & self.classic_ends_at_goal
        return jnp.where(ends, jnp.zeros_like(cost), -cost), ends
