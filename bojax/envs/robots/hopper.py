"""Jumping with one leg (thesis, p. 107): Gym's Hopper with a goal."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.control import ControlStep, penalties
from bojax.envs.robots.base import RobotTask
from bojax.envs.spaces import Box
from bojax.numerics.choices import Choice, one_of
from bojax.robots.models import RobotModel, packaged
from bojax.robots.simulator import Physics, RobotState

_FASTEST, _UNHEALTHY = 10.0, 100.0


class Hopper(RobotTask):
    """A torso on a leg of three segments in a vertical plane; actions are the torques of the joints.

    The goal is a height of the torso above `goal_height`; an angle of the torso beyond `failure_angle` in
    either direction is a failure (p. 107). In the author's code a height below 0.7 m is a failure too
    (`failure_height`). The classic reward follows Gym's Hopper-v5: forward velocity + 1 - 0.001 times the
    sum of the squared actions. An unhealthy state (height below 0.7 m, |angle| above 0.2 rad, or any other
    component of the state above 100 in magnitude) loses the 1 and ends the episode. With
    `classic_reward: published` it follows the author's code, see `bojax.envs.control.penalties`.

    As in Gym, an episode starts in the standing configuration, with noise uniform in [-0.005, 0.005] on every
    position and velocity.

    Settings: `bojax.envs.robots.settings.Hopper`.
    """

    goal_height: Float[Array, ""]
    failure_angle: Float[Array, ""]
    failure_height: Float[Array, ""]
    physics: Physics
    max_steps: int = eqx.field(static=True)
    classic_reward: Choice = eqx.field(converter=one_of("gym", "published"))

    @property
    @override
    def model(self) -> RobotModel:
        return packaged("hopper")

    @property
    @override
    def observation_space(self) -> Box:
        """Height and angle of the torso, angles of the three joints, and all six velocities, clipped.

        The bounds come from the author's code, in m and rad, m/s and rad/s.
        """
        low = jnp.asarray([-0.1, -0.25, -0.4, -0.4, -0.32] + 6 * [-7.0], self.dtype)
        return Box(low, jnp.asarray([1.3, 0.02, 0.025, 0.03, 0.7] + 6 * [7.0], self.dtype))

    @override
    def reset(self, key: Key[Array, ""]) -> RobotState:
        noise = jax.random.uniform(key, (2, 6), jnp.float32, -5e-3, 5e-3)
        standing = jnp.asarray(self.simulator.mujoco_model.qpos0, jnp.float32)
        return self.simulator.state(standing + noise[0], noise[1])

    @override
    def observe(self, state: RobotState) -> Float[Array, "11"]:
        velocities = jnp.clip(state.qvel, -_FASTEST, _FASTEST)
        return jnp.concatenate([state.qpos[1:], velocities]).astype(self.dtype)

    @override
    def is_goal(self, state: RobotState) -> Bool[Array, ""]:
        return state.qpos[1].astype(self.dtype) > self.goal_height

    @override
    def is_failure(self, state: RobotState) -> Bool[Array, ""]:
        height, angle = state.qpos[1:3].astype(self.dtype)
        return (jnp.abs(angle) > self.failure_angle) | (height < self.failure_height)

    @override
    def classic(self, step: ControlStep) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        rest = jnp.concatenate([step.after.qpos[2:], step.after.qvel])
        is_healthy = jnp.all(jnp.abs(rest) < _UNHEALTHY)
        is_healthy = is_healthy & (step.after.qpos[1] > 0.7) & (jnp.abs(step.after.qpos[2]) < 0.2)
        forward = ((step.after.qpos[0] - step.state.qpos[0]) / self.simulator.time_step).astype(self.dtype)
        paid = forward + is_healthy.astype(self.dtype) - 1e-3 * jnp.sum(step.action * step.action)
        published, ends = penalties(step, -1000.0, self.dtype)
        is_gym = self.classic_reward.is_("gym")
        return jnp.where(is_gym, paid, published), jnp.where(is_gym, ~is_healthy, ends)
