"""Drive a weak car up a hill by building momentum (thesis, p. 106): Gym's MountainCar."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.control import ControlTask
from bojax.envs.spaces import Box
from bojax.problems.pomdp.mountain_car import HIGH, LOW, roll


class MountainCar(ControlTask):
    """A car in a valley of height sin(3 x); its state is the position x and the velocity per step.

    The goal is a position, 0.5 as in Gym; Fig. 5.7 says 0.9 of the way from the left wall to the right,
    which is 0.42. The classic reward is -1 a step, including the step that reaches the goal, and the goal
    ends the episode. A wall at the left stops the car.

    The thesis has a continuous action, the author's code three (`actions: thresholded`). With `power` 0.0015
    and `goal_position` 0.45 the dynamics equal Gym's MountainCarContinuous.

    An episode begins at rest, at a position uniform in [-0.6, -0.4].

    Settings: `bojax.envs.settings.MountainCar`.
    """

    goal_position: Float[Array, ""]
    power: Float[Array, ""]
    gravity: Float[Array, ""]
    threshold: Float[Array, ""]
    max_steps: int = eqx.field(static=True)
    actions: Literal["continuous", "thresholded"] = eqx.field(static=True)

    @property
    @override
    def observation_space(self) -> Box:
        """Position and velocity; the bounds also limit the motion."""
        dtype = self.power.dtype
        return Box(jnp.asarray(LOW, dtype), jnp.asarray(HIGH, dtype))

    @property
    @override
    def action_space(self) -> Box:
        """The fraction of the full force, positive to the right."""
        one = jnp.ones((1,), self.power.dtype)
        return Box(-one, one)

    @override
    def reset(self, key: Key[Array, ""]) -> Float[Array, "2"]:
        position = jax.random.uniform(key, (), self.power.dtype, -0.6, -0.4)
        return jnp.stack([position, jnp.zeros_like(position)])

    @override
    def advance(
        self, key: Key[Array, ""], state: Float[Array, "2"], action: Float[Array, "1"]
    ) -> Float[Array, "2"]:
        """Update the velocity, then the position; the left wall stops the car."""
        (force,) = action
        if self.actions == "thresholded":
            force = jnp.where(jnp.abs(force) < self.threshold, jnp.zeros_like(force), jnp.sign(force))
        return roll(state, force * self.power, self.gravity)

    @override
    def is_goal(self, state: Float[Array, "2"]) -> Bool[Array, ""]:
        return state[0] >= self.goal_position
