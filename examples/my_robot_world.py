"""A robot of my own that follows a planner: a base whose servos are sent from pose to pose of a path."""

from pathlib import Path
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import pydantic
from jaxtyping import Array, Float, Key

from bojax.config.component import Component, Slot
from bojax.motions.base import Pose
from bojax.problems.vehicles.base import TrackingResult, Vehicle
from bojax.robots.models import from_file
from bojax.robots.settings import MJX
from bojax.robots.simulator import Physics, RobotState, Simulated, Simulator


class Base(Simulated, Vehicle):
    """A base that planners know only through the paths that they plan and the poses that they observe."""

    class Config(pydantic.BaseModel):
        """Settings of the vehicle."""

        physics: Annotated[Component, Slot("physics")] = MJX()
        substeps: int = 20

    physics: Physics
    substeps: int = eqx.field(static=True)  # steps of the physics from pose to pose

    @property
    def simulator(self) -> Simulator:
        """The MJCF file beside this module."""
        return Simulator(self.physics, from_file(Path(__file__).with_suffix(".xml")), self.substeps)

    def reset(self, pose: Pose) -> RobotState:
        """The base at rest at a pose: x and y in m, heading in rad."""
        return self.simulator.state(pose, jnp.zeros_like(pose))

    def pose(self, state: RobotState) -> Pose:
        """True pose; the simulation runs in 32 bits, a problem in 64."""
        return state.qpos.astype(self.physics.max_speed.dtype)

    def estimate(self, state: RobotState) -> Pose:
        """The true pose."""
        return self.pose(state)

    def follow(
        self,
        key: Key[Array, ""],
        state: RobotState,
        path: Float[Array, "S 3"],
        end: Pose,
        noise: Float[Array, "3"] | None,
    ) -> TrackingResult:
        """Send the poses of the path to the servos, one after the other."""

        def step(state: RobotState, pose: Pose) -> tuple[RobotState, RobotState]:
            state = self.simulator.advance(state, pose)
            return state, state

        state, states = jax.lax.scan(step, state, path.astype(jnp.float32))
        poses = jax.vmap(self.pose)(states)
        failed = self.simulator.has_diverged(state)
        return TrackingResult(state, poses, poses, frames=states.qpos, failed=failed)
