"""The protocol of a vehicle, and the vehicle that follows every path exactly."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.motions.base import Path, Pose
from bojax.numerics.angles import wrap_to_2pi

VehicleState = Any
"""True state of a vehicle: a tree of arrays."""

PoseNoise = Float[Array, "3"] | None  # of measurements, see `Vehicle.follow`


class TrackingResult(eqx.Module):
    """Result of tracking a path."""

    state: VehicleState  # state of the vehicle afterwards
    poses: Float[Array, "S 3"]  # true pose of the vehicle at each pose of the path, in the world frame
    estimates: Float[Array, "S 3"]  # the vehicle's own estimates of these poses
    # Position in metres and orientation (w, x, y, z) of its sensor at these poses; None on the ground
    sensor_poses: Float[Array, "S 7"] | None = None
    # Generalised positions during the motion, for an animation; None if there is nothing to animate
    frames: Float[Array, "F Q"] | None = None
    failed: Bool[Array, ""] | None = None  # whether the simulation has diverged; None if it cannot diverge


class Vehicle(eqx.Module):
    """The robot that executes paths in the world; planners assume that every path is followed exactly."""

    @abc.abstractmethod
    def reset(self, pose: Pose) -> VehicleState:
        """The state of the vehicle at rest at a pose, which the vehicle knows."""

    @abc.abstractmethod
    def pose(self, state: VehicleState) -> Pose:
        """True pose of the vehicle."""

    @abc.abstractmethod
    def estimate(self, state: VehicleState) -> Pose:
        """The vehicle's estimate of its pose, from which its next path begins."""

    @abc.abstractmethod
    def follow(
        self, key: Key[Array, ""], state: VehicleState, path: Path, end: Pose, noise: PoseNoise
    ) -> TrackingResult:
        """Track a path, and come to rest.

        Args:
            key: Key of the measurement noise.
            state: State of the vehicle at the start.
            path: Poses in the world frame, starting from `estimate(state)`.
            end: Pose at which to come to rest: the last position of the path, with the desired heading.
            noise: Standard deviations of a pose measurement, in m and rad; None for exact measurements.
        """

    def measure(self, key: Key[Array, ""], state: VehicleState, noise: Float[Array, "3"]) -> Pose:
        """Measurement of the pose, from which the next path is planned; `noise` as in `follow`."""
        pose = self.pose(state)
        return pose + noise * jax.random.normal(key, (3,), pose.dtype)

    def stopped_at(
        self, tracked: TrackingResult, last: Int[Array, ""]
    ) -> tuple[VehicleState, Int[Array, ""]]:
        """The state if the task has ended at pose `last` of the path, and the index of the last pose driven.

        A simulated vehicle has driven on to the end of the path.
        """
        return tracked.state, jnp.full_like(last, tracked.poses.shape[0] - 1)

    @property
    def turning_radius(self) -> float:
        """Smallest radius of a curve that the vehicle can follow, in metres."""
        return 0.0

    @property
    def reach(self) -> float:
        """Length of the longest path that the vehicle can complete, in metres."""
        return float("inf")

    @property
    def flight_altitude(self) -> float | None:
        """Flight altitude in metres; None on the ground."""
        return None


class Exact(Vehicle):
    """A vehicle that follows every path exactly and can turn on the spot; its state is its pose.

    Settings: `bojax.problems.vehicles.settings.Exact`.
    """

    @override
    def reset(self, pose: Pose) -> Pose:
        return pose

    @override
    def pose(self, state: Pose) -> Pose:
        return state

    @override
    def estimate(self, state: Pose) -> Pose:
        return state

    @override
    def follow(
        self, key: Key[Array, ""], state: Pose, path: Path, end: Pose, noise: PoseNoise
    ) -> TrackingResult:
        estimates = path
        if noise is not None:
            estimates = path + noise[None] * jax.random.normal(key, path.shape, path.dtype)
        return TrackingResult(end, path, estimates)

    @override
    def stopped_at(self, tracked: TrackingResult, last: Int[Array, ""]) -> tuple[Pose, Int[Array, ""]]:
        """The pose at `last`, with its heading in [0, 2 pi)."""
        pose = tracked.poses[last]
        return pose.at[2].set(wrap_to_2pi(pose[2])), last
