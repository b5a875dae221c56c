"""Reaching a point with a planar arm of two links (thesis, p. 107): Gym's Reacher with a goal."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.base import TimeStep
from bojax.envs.control import ControlStep
from bojax.envs.robots.base import RobotTask
from bojax.envs.spaces import Box
from bojax.numerics.choices import Choice, one_of
from bojax.robots.models import RobotModel, packaged
from bojax.robots.simulator import Physics, RobotState

_LINKS = 0.1, 0.11
"""Lengths of the upper arm and of the forearm, in metres."""


class Reacher(RobotTask):
    """Two links over a table with a target; actions are the torques of shoulder and elbow.

    The goal is a distance between fingertip and target below `goal_distance` (p. 107), at any speed. There is
    no failure. The classic reward follows Gym's Reacher-v5: minus the distance after the step, minus the
    sum of the squared actions. As in Gym, nothing terminates an episode with the classic reward. With
    `second_action: fixed` the elbow's torque is always 1, by an error of the author's code.

    As in Gym, initial angles are uniform in [-0.1, 0.1] rad and their velocities in [-0.005, 0.005] rad/s.
    The target is at rest, uniform in the disc of radius `target_radius` about the shoulder.

    Settings: `bojax.envs.robots.settings.Reacher`.
    """

    goal_distance: Float[Array, ""]
    target_radius: Float[Array, ""]
    physics: Physics
    max_steps: int = eqx.field(static=True)
    second_action: Choice = eqx.field(converter=one_of("free", "fixed"))

    @property
    @override
    def model(self) -> RobotModel:
        return packaged("reacher")

    @property
    @override
    def observation_space(self) -> Box:
        """The observations of Gym's Reacher-v4, with the bounds of the author's code.

        Cosines of shoulder and elbow, their sines, x and y of the target in metres, the joint velocities in
        rad/s, and the vector from the target to the fingertip in metres, whose z component is 0.
        """
        low = [-1.0, -1.0, -1.0, -0.17, -0.2, -0.2, -49.0, -5.6, -0.22, -0.2, 0.0]
        high = [1.0, 1.0, 1.0, 1.0, 0.2, 0.2, 87.0, 33.0, 0.4, 0.35, 1e-4]
        return Box(jnp.asarray(low, self.dtype), jnp.asarray(high, self.dtype))

    @override
    def reset(self, key: Key[Array, ""]) -> RobotState:
        keys = jax.random.split(key, 4)
        angles = jax.random.uniform(keys[0], (2,), jnp.float32, -0.1, 0.1)
        speeds = jax.random.uniform(keys[1], (2,), jnp.float32, -5e-3, 5e-3)
        radius = self.target_radius.astype(jnp.float32) * jnp.sqrt(
            jax.random.uniform(keys[2], (), jnp.float32)
        )
        bearing = jax.random.uniform(keys[3], (), jnp.float32, -jnp.pi, jnp.pi)
        target = radius * jnp.stack([jnp.cos(bearing), jnp.sin(bearing)])
        return self.simulator.state(
            jnp.concatenate([angles, target]), jnp.concatenate([speeds, jnp.zeros_like(speeds)])
        )

    @override
    def observe(self, state: RobotState) -> Float[Array, "11"]:
        angles, target = state.qpos[:2], state.qpos[2:]
        gap = fingertip(angles) - target
        parts = jnp.cos(angles), jnp.sin(angles), target, state.qvel[:2], gap, jnp.zeros_like(gap[:1])
        return jnp.concatenate(parts).astype(self.dtype)

    @override
    def step(
        self, key: Key[Array, ""], state: RobotState, action: Float[Array, "2"]
    ) -> tuple[RobotState, TimeStep]:
        is_fixed = self.second_action.is_("fixed")
        return super().step(key, state, jnp.where(is_fixed, action.at[1].set(1.0), action))

    @override
    def is_goal(self, state: RobotState) -> Bool[Array, ""]:
        return self.distance(state) < self.goal_distance

    def distance(self, state: RobotState) -> Float[Array, ""]:
        """Distance between fingertip and target, in metres."""
        gap = fingertip(state.qpos[:2]) - state.qpos[2:]
        return jnp.sqrt(jnp.sum(gap * gap)).astype(self.dtype)

    @override
    def classic(self, step: ControlStep) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        return -self.distance(step.after) - jnp.sum(step.action * step.action), jnp.zeros_like(step.success)


def fingertip(angles: Float[Array, "2"]) -> Float[Array, "2"]:
    """Position of the fingertip in metres for angles of shoulder and elbow."""
    upper, lower = _LINKS
    first, second = angles[0], angles[0] + angles[1]
    along = jnp.stack([jnp.cos(first), jnp.sin(first)]), jnp.stack([jnp.cos(second), jnp.sin(second)])
    return upper * along[0] + lower * along[1]
