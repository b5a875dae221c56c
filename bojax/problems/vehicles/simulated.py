"""The common part of vehicles that MJX simulates."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.motions.base import Pose
from bojax.numerics.angles import wrap_to_2pi
from bojax.problems.vehicles.base import Vehicle
from bojax.robots.quaternions import rotate_yaw, yaw_of
from bojax.robots.simulator import RobotState, Simulated


class SimulatedState(eqx.Module):
    """State of a simulated vehicle between two paths."""

    robot: RobotState  # state of the simulation
    reading: Pose  # last measurement of the pose


class SimulatedVehicle(Simulated, Vehicle):
    """A simulated robot with a free joint whose pose a tracking system measures.

    Subclasses define how the robot follows paths. The vehicle's estimate of its pose, from which paths are
    planned, is the last measurement; measurements are not filtered.
    """

    def __check_init__(self):
        """Compile the model, see `Simulator`."""
        _ = self.simulator

    @override
    def pose(self, state: SimulatedState) -> Pose:
        return planar(state.robot.qpos).astype(state.reading.dtype)

    @override
    def estimate(self, state: SimulatedState) -> Pose:
        return state.reading

    @override
    def measure(self, key: Key[Array, ""], state: SimulatedState, noise: Float[Array, "3"]) -> Pose:
        """The last measurement, whose noise was drawn when it was made."""
        return state.reading

    def at_rest(self, pose: Pose, height: Float[Array, ""]) -> SimulatedState:
        """The robot upright and at rest at a pose and a height in metres; other joints as in the model."""
        model = self.simulator.mujoco_model
        level = jnp.asarray([1.0, 0.0, 0.0, 0.0], pose.dtype)
        others = jnp.asarray(model.qpos0[7:], pose.dtype)
        qpos = jnp.concatenate(
            [pose[:2], height.astype(pose.dtype)[None], rotate_yaw(level, pose[2]), others]
        )
        return SimulatedState(self.simulator.state(qpos, jnp.zeros((model.nv,), jnp.float32)), pose)


def frames_of(qpos: Float[Array, "T Q"], every: int) -> Float[Array, "F Q"]:
    """Every so many positions without the first, counted from the last one, which a film ends with."""
    return qpos[(qpos.shape[0] - 2) % every + 1 :: every]


def planar(qpos: Float[Array, "Q"]) -> Float[Array, "3"]:
    """Position in metres and heading in [0, 2 pi) of a robot with a free joint."""
    return jnp.concatenate([qpos[:2], wrap_to_2pi(yaw_of(qpos[3:7]))[None]])
