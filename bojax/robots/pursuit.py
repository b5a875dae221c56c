"""Pure pursuit: steer along the circle through a look-ahead point of the path (Coulter, 1992), for a car."""

from dataclasses import dataclass
from math import tan

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bojax.robots.models import MjModel

PIECES = 8
"""Number of route segments between two poses of a path."""


class Route(eqx.Module):
    """A densely sampled path, continued along a straight line past its end."""

    points: Float[Array, "N 2"]  # positions in metres, from the start
    arc: Float[Array, "N"]  # arc length of each point, in metres
    heading: Float[Array, ""]  # heading at the end, in radians

    @property
    def length(self) -> Float[Array, ""]:
        """Total arc length in metres."""
        return self.arc[-1]

    def at(self, arc: Float[Array, ""]) -> Float[Array, "2"]:
        """The position at an arc length; past the end, on the straight continuation."""
        x, y = (jnp.interp(arc, self.arc, self.points[:, axis]) for axis in range(2))
        beyond = jnp.maximum(arc - self.length, 0.0)
        along = jnp.stack([jnp.cos(self.heading), jnp.sin(self.heading)])
        return jnp.stack([x, y]) + beyond * along

    def nearest(
        self, position: Float[Array, "2"], after: Int[Array, ""], ahead: Float[Array, ""]
    ) -> Int[Array, ""]:
        """Index of the nearest point from index `after` to `ahead` metres further along the route.

        The next point is always included; otherwise a robot would never advance along a coarse route.
        """
        index = jnp.arange(self.arc.shape[0], dtype=after.dtype)
        is_near = (index >= after) & ((self.arc <= self.arc[after] + ahead) | (index == after + 1))
        squared = jnp.sum((self.points - position[None]) ** 2, axis=-1)
        return jnp.argmin(jnp.where(is_near, squared, jnp.inf)).astype(after.dtype)


def route(start: Float[Array, "3"], path: Float[Array, "S 3"]) -> Route:
    """The route from a pose through the poses of a path: cubic Hermite curves tangential to the headings.

    Pose s of the path is the point with index `(s + 1) * PIECES`.
    """
    poses = jnp.concatenate([start[None], path])
    before, after = poses[:-1, None], poses[1:, None]
    chord = jnp.sqrt(jnp.sum((after - before)[..., :2] ** 2, axis=-1, keepdims=True))
    u = (jnp.arange(1, PIECES + 1, dtype=path.dtype) / PIECES)[None, :, None]
    curve = (
        (1.0 + 2.0 * u) * (1.0 - u) ** 2 * before[..., :2]
        + u * (1.0 - u) ** 2 * chord * _direction(before)
        + u**2 * (3.0 - 2.0 * u) * after[..., :2]
        - u**2 * (1.0 - u) * chord * _direction(after)
    )
    points = jnp.concatenate([start[None, :2], curve.reshape(-1, 2)])
    steps = jnp.sqrt(jnp.sum((points[1:] - points[:-1]) ** 2, axis=-1))
    arc = jnp.concatenate([jnp.zeros((1,), path.dtype), jnp.cumsum(steps)])
    return Route(points, arc, path[-1, 2])


def curvature(pose: Float[Array, "3"], goal: Float[Array, "2"]) -> Float[Array, ""]:
    """Curvature 2 y / d^2 of the circle that is tangential to a pose and passes through a point, in 1/m.

    y is the lateral offset of the point to the left, d its distance.
    """
    ahead = goal - pose[:2]
    left = jnp.cos(pose[2]) * ahead[1] - jnp.sin(pose[2]) * ahead[0]
    squared = jnp.sum(ahead * ahead)
    return 2.0 * left / jnp.maximum(squared, jnp.finfo(squared.dtype).eps)


def wheel_angles(
    curvature: Float[Array, ""], wheelbase: Float[Array, ""], half_track: Float[Array, ""]
) -> Float[Array, "2"]:
    """Ackermann angles of the left and the right front wheel, at which neither slips, in rad.

    The curvature of the path of the midpoint of the rear axle, positive to the left, in 1/m, must be below 1
    / `half_track` in magnitude. The wheelbase is the distance between the axles, and `half_track` half that
    between the steering axes of the front wheels, in metres.
    """
    turn = wheelbase * curvature
    return jnp.stack(
        [jnp.arctan(turn / (1.0 - half_track * curvature)), jnp.arctan(turn / (1.0 + half_track * curvature))]
    )


def _direction(poses: Float[Array, "*S 3"]) -> Float[Array, "*S 2"]:
    return jnp.stack([jnp.cos(poses[..., 2]), jnp.sin(poses[..., 2])], axis=-1)


@dataclass(frozen=True)
class CarParameters:
    """Parameters of the robot that its controller uses."""

    wheelbase: float  # distance between the axles, in metres
    half_track: float  # half the distance between the steering axes of the front wheels, in metres
    max_angle: float  # largest steering angle of a front wheel, in radians
    full_speed: float  # speed for a drive command of 1, in m/s

    @property
    def turning_radius(self) -> float:
        """Smallest turning radius of the midpoint of the rear axle, in metres; the inner wheel limits it."""
        return self.wheelbase / tan(self.max_angle) + self.half_track


def car_parameters(model: MjModel) -> CarParameters:
    """The parameters of a compiled model of the robot."""
    wheelbase, half_track, _ = model.body("front_left").pos
    drive = model.actuator("drive")
    radius = model.geom("rear_left").size[0]
    return CarParameters(
        wheelbase=float(wheelbase),
        half_track=float(half_track),
        max_angle=float(model.actuator("steer_left").ctrlrange[1]),
        full_speed=float(radius * drive.gainprm[0] / -drive.biasprm[2]),
    )
