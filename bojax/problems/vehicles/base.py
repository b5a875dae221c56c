"""What a vehicle is, and the one that follows every path exactly."""

import abc
from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Bool, Float, Key

from bojax.motions.base import Pose
from bojax.numerics.angles import wrap_to_2pi

Body = Any
"""The true state of a vehicle: a tree of arrays."""


class Ride(eqx.Module):
    """What following a path led to.

    Attributes:
        body: The vehicle after it.
        poses: Where it really was, once for every pose of the path; world frame.
        estimates: Where it took itself to be then.
        mounts: Position in metres and orientation (w, x, y, z) of its sensor then; None on the ground.
        frames: Generalised positions along the way, for an animation; None where there is nothing to draw.
        failed: Its simulation has diverged; None where it cannot.
    """

    body: Body
    poses: Float[Array, "S 3"]
    estimates: Float[Array, "S 3"]
    mounts: Float[Array, "S 7"] | None = None
    frames: Float[Array, "F Q"] | None = None
    failed: Bool[Array, ""] | None = None


class Vehicle(eqx.Module):
    """A robot in the world behind a planning problem; planners know it by its paths alone."""

    @abc.abstractmethod
    def place(self, pose: Pose) -> Body:
        """The vehicle at rest at a pose, which it knows."""

    @abc.abstractmethod
    def pose(self, body: Body) -> Pose:
        """Where it really is."""

    @abc.abstractmethod
    def estimate(self, body: Body) -> Pose:
        """Where it takes itself to be: what it begins its next path from."""

    @abc.abstractmethod
    def follow(
        self,
        key: Key[Array, ""],
        body: Body,
        path: Float[Array, "S 3"],
        end: Pose,
        noise: Float[Array, "3"] | None,
    ) -> Ride:
        """Follow a path.

        Args:
            key: What readings draw their noise from.
            body: The vehicle before it.
            path: Poses of the path, in the world's frame, as it was planned from `estimate(body)`.
            end: Pose to come to rest at: the path's last position, with the heading wanted there.
            noise: Standard deviations of a reading of its pose, in m and rad; None for exact readings.
        """

    def read(self, key: Key[Array, ""], body: Body, noise: Float[Array, "3"]) -> Pose:
        """A reading of its pose, to plan from.

        Args:
            key: What the reading draws its noise from.
            body: The vehicle.
            noise: Its standard deviations, in m and rad.
        """
        pose = self.pose(body)
        return pose + noise * jax.random.normal(key, (3,), pose.dtype)

    def stopped_at(self, body: Body, pose: Pose) -> Body:
        """The vehicle, where its task ended at a pose on the way; what has physics has driven on."""
        del pose
        return body

    @property
    def turning_radius(self) -> float:
        """Radius of the tightest curve that it can drive, in metres."""
        return 0.0

    @property
    def reach(self) -> float:
        """Length of the longest path that it can follow to its end, in metres."""
        return float("inf")

    @property
    def flight_altitude(self) -> float | None:
        """Altitude in metres at which it flies; None on the ground."""
        return None


class Exact(Vehicle):
    """Follows every path exactly, and turns on the spot; its body is its pose."""

    def place(self, pose: Pose) -> Pose:
        """See `Vehicle`."""
        return pose

    def pose(self, body: Pose) -> Pose:
        """See `Vehicle`."""
        return body

    def estimate(self, body: Pose) -> Pose:
        """The pose itself."""
        return body

    def follow(
        self,
        key: Key[Array, ""],
        body: Pose,
        path: Float[Array, "S 3"],
        end: Pose,
        noise: Float[Array, "3"] | None,
    ) -> Ride:
        """See `Vehicle`."""
        del body
        estimates = path
        if noise is not None:
            estimates = path + noise[None] * jax.random.normal(key, path.shape, path.dtype)
        return Ride(end, path, estimates)

    def stopped_at(self, body: Pose, pose: Pose) -> Pose:
        """It stands there."""
        del body
        return pose.at[2].set(wrap_to_2pi(pose[2]))
