"""A robot of my own behind a planning problem: a base whose servos are sent from pose to pose of a path."""

from pathlib import Path
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import pydantic
from jaxtyping import Array, Float, Key

from bojax.config.component import Component, Slot
from bojax.motions.base import Pose
from bojax.problems.vehicles.base import Ride, Vehicle
from bojax.robots.models import from_file
from bojax.robots.settings import MJX
from bojax.robots.simulator import Physics, RobotState, Simulator


class Base(Vehicle):
    """Planners know nothing of it: they plan paths, and see where it came to."""

    class Config(pydantic.BaseModel):
        """What a file may set."""

        physics: Annotated[Component, Slot("physics")] = MJX()
        substeps: int = 20

    physics: Physics
    substeps: int = eqx.field(static=True)  # steps of the physics from pose to pose

    @property
    def simulator(self) -> Simulator:
        """The MJCF beside this file."""
        return Simulator(self.physics, from_file(Path(__file__).with_suffix(".xml")), self.substeps)

    def place(self, pose: Pose) -> RobotState:
        """At rest at a pose: x and y in m, heading in rad."""
        return self.simulator.state(pose, jnp.zeros_like(pose))

    def pose(self, body: RobotState) -> Pose:
        """Where it is; the physics has 32-bit numbers, a problem 64."""
        return body.qpos.astype(self.physics.max_speed.dtype)

    def estimate(self, body: RobotState) -> Pose:
        """It always knows where it is."""
        return self.pose(body)

    def follow(
        self,
        key: Key[Array, ""],
        body: RobotState,
        path: Float[Array, "S 3"],
        end: Pose,
        noise: Float[Array, "3"] | None,
    ) -> Ride:
        """Tell the servos one pose after the other."""

        def drive(body: RobotState, pose: Pose) -> tuple[RobotState, RobotState]:
            body = self.simulator.advance(body, pose)
            return body, body

        body, way = jax.lax.scan(drive, body, path.astype(jnp.float32))
        poses = jax.vmap(self.pose)(way)
        return Ride(body, poses, poses, frames=way.qpos, failed=self.simulator.has_diverged(body))
