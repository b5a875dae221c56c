"""Swing a two-link pendulum up with one weak motor (thesis, p. 107): Gym's Acrobot, driven at its base."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.control import ControlStep, ControlTask, sign, symmetric
from bojax.envs.spaces import Box
from bojax.numerics.angles import wrap_to_pi
from bojax.numerics.choices import Choice, one_of

_GRAVITY = 9.8


class DoublePendulum(ControlTask):
    """Two rods on two joints, one of them driven.

    The state is the angle of the first rod from hanging down, the angle of the second rod from the first,
    both in radians, and their velocities. A rod is 1 m long and weighs 1 kg, with the centre of mass in the
    middle and a moment of inertia of 1 kg m^2 about it. The equations of motion follow Sutton and Barto
    (Reinforcement Learning, 1st edition, Section 11.3), with a torque at either joint; a time step is one
    Runge-Kutta step of fourth order.

    The goal is to bring the tip near the highest point that it can reach, 2 m above the base: with `goal`
    `"distance"` to a distance below `goal_distance` (p. 107), with `"height"` to a height above
    2 m - `goal_distance` (Gym, and the author's code). The classic reward is -1 a step and 0 at the goal,
    which ends the episode.

    As in Gym, all four numbers of the initial state are uniform in [-0.1, 0.1].

    Settings: `bojax.envs.settings.DoublePendulum`.
    """

    goal_distance: Float[Array, ""]
    max_torque: Float[Array, ""]
    time_step: Float[Array, ""]
    max_steps: int = eqx.field(static=True)
    actuated: Choice = eqx.field(converter=one_of("base", "elbow"))
    goal: Literal["distance", "height"] = eqx.field(static=True)
    actions: Choice = eqx.field(converter=one_of("continuous", "sign"))

    @property
    @override
    def observation_space(self) -> Box:
        """Cosine and sine of both angles, and both velocities in rad/s."""
        one = jnp.ones_like(self.time_step)
        return symmetric(one, one, one, one, 4.0 * jnp.pi * one, 9.0 * jnp.pi * one)

    @property
    @override
    def action_space(self) -> Box:
        """The torque, in N m."""
        return symmetric(self.max_torque)

    @override
    def reset(self, key: Key[Array, ""]) -> Float[Array, "4"]:
        return jax.random.uniform(key, (4,), self.time_step.dtype, -0.1, 0.1)

    @override
    def observe(self, state: Float[Array, "4"]) -> Float[Array, "6"]:
        first, second, *speeds = state
        return jnp.stack([jnp.cos(first), jnp.sin(first), jnp.cos(second), jnp.sin(second), *speeds])

    @override
    def advance(
        self, key: Key[Array, ""], state: Float[Array, "4"], action: Float[Array, "1"]
    ) -> Float[Array, "4"]:
        """One Runge-Kutta step, after which angles are wrapped and velocities are clipped to their bounds."""
        (torque,) = action
        torque = jnp.where(self.actions.is_("sign"), self.max_torque * sign(torque), torque)
        h = self.time_step
        k1 = self.velocity(state, torque)
        k2 = self.velocity(state + 0.5 * h * k1, torque)
        k3 = self.velocity(state + 0.5 * h * k2, torque)
        k4 = self.velocity(state + h * k3, torque)
        state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        fastest = self.observation_space.high[4:]
        return jnp.concatenate([wrap_to_pi(state[:2]), jnp.clip(state[2:], -fastest, fastest)])

    def velocity(self, state: Float[Array, "4"], torque: Float[Array, ""]) -> Float[Array, "4"]:
        """Time derivative of the state: M(q) q'' + c(q, q') = torque, solved for q''."""
        first, second, speed1, speed2 = state
        coupling = 0.5 * jnp.cos(second)
        inertia11 = 0.25 + (1.25 + 2.0 * coupling) + 2.0
        inertia12 = 0.25 + coupling + 1.0
        inertia22 = 1.25
        weight2 = 0.5 * _GRAVITY * jnp.sin(first + second)
        weight1 = 1.5 * _GRAVITY * jnp.sin(first) + weight2
        twist = 0.5 * jnp.sin(second)
        rest1 = weight1 - twist * speed2 * (speed2 + 2.0 * speed1)
        rest2 = weight2 + twist * speed1**2
        force1, force2 = -rest1, -rest2
        is_base = self.actuated.is_("base")
        force1 = jnp.where(is_base, torque + force1, force1)
        force2 = jnp.where(is_base, force2, torque + force2)
        ratio = inertia12 / inertia11
        acceleration2 = (force2 - ratio * force1) / (inertia22 - ratio * inertia12)
        acceleration1 = (force1 - inertia12 * acceleration2) / inertia11
        return jnp.stack([speed1, speed2, acceleration1, acceleration2])

    @override
    def is_goal(self, state: Float[Array, "4"]) -> Bool[Array, ""]:
        x = jnp.sin(state[0]) + jnp.sin(state[0] + state[1])
        below = 2.0 + jnp.cos(state[0]) + jnp.cos(state[0] + state[1])
        if self.goal == "height":
            return below < self.goal_distance
        return x**2 + below**2 < self.goal_distance**2

    @override
    def classic(self, step: ControlStep) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        one = jnp.ones_like(step.after[0])
        return jnp.where(step.success, jnp.zeros_like(one), -one), step.success
