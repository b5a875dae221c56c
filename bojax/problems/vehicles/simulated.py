"""What vehicles that MJX steps share."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from bojax.motions.base import Pose
from bojax.numerics.angles import wrap_to_2pi
from bojax.problems.vehicles.base import Vehicle
from bojax.robots.quaternions import turned, yaw_of
from bojax.robots.simulator import Physics, RobotState, Simulator


class SimulatedBody(eqx.Module):
    """A simulated vehicle between two paths.

    Attributes:
        state: Its true state.
        reading: The last reading of its pose.
    """

    state: RobotState
    reading: Pose


class SimulatedVehicle(Vehicle):
    """A robot with a free joint, of whose pose a tracking system tells; a subclass says how it follows paths.

    What it takes its pose to be, and what plans are made from, is the last reading, not a filter's estimate.

    Attributes:
        physics: How MJX computes.
    """

    physics: eqx.AbstractVar[Physics]

    def __check_init__(self):
        """See `Simulator`."""
        _ = self.simulator

    @property
    @abc.abstractmethod
    def simulator(self) -> Simulator:
        """The physics."""

    def pose(self, body: SimulatedBody) -> Pose:
        """See `Vehicle`."""
        return planar(body.state.qpos).astype(body.reading.dtype)

    def estimate(self, body: SimulatedBody) -> Pose:
        """The last reading."""
        return body.reading

    def read(self, key: Key[Array, ""], body: SimulatedBody, noise: Float[Array, "3"]) -> Pose:
        """The last reading: it had its noise when it was made."""
        del key, noise
        return body.reading

    def at_rest(self, pose: Pose, height: Float[Array, ""]) -> SimulatedBody:
        """The robot upright and at rest at a pose, at a height in metres, other joints as in the model."""
        model = self.simulator.mujoco_model
        level = jnp.asarray([1.0, 0.0, 0.0, 0.0], pose.dtype)
        others = jnp.asarray(model.qpos0[7:], pose.dtype)
        qpos = jnp.concatenate([pose[:2], height.astype(pose.dtype)[None], turned(level, pose[2]), others])
        return SimulatedBody(self.simulator.state(qpos, jnp.zeros((model.nv,), jnp.float32)), pose)


def planar(qpos: Float[Array, "Q"]) -> Float[Array, "3"]:
    """Position in metres and heading in rad, in [0, 2 pi), of a robot with a free joint."""
    return jnp.concatenate([qpos[:2], wrap_to_2pi(yaw_of(qpos[3:7]))[None]])
