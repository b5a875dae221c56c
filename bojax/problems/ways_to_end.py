"""The shortest ways to the point at which a survey must end."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bojax.motions.base import Path, Pose
from bojax.motions.polylines import headings_along, lengths_along, points_along
from bojax.problems.walls import ROUNDING, Drive


class WaysToEnd(eqx.Module):
    """Shortest ways to the end point from everywhere, as a table of the next corner of each.

    A shortest way is a polyline: straight from a position to the first corner of an obstacle at which it
    bends, or to the end point, and on from there. A lookup of the first corner makes the distance exact and
    as cheap as a straight line, whatever the obstacles.

    Attributes:
        corners: Where ways bend, and last the end point, m.
        following: Index of the corner after each; that of the end point is its own.
        rest: Distance from each corner to the end point along its way, m.
        first: Index of the first corner for positions around each grid point; the first axis is y.
        origin: Position of `first[0, 0]`, m.
        spacing: Distance between two grid points, m.
        legs: Largest number of straight pieces of a way.
    """

    corners: Float[Array, "C 2"]
    following: Int[Array, "C"]
    rest: Float[Array, "C"]
    first: Int[Array, "H W"]
    origin: Float[Array, "2"]
    spacing: Float[Array, ""]
    legs: int = eqx.field(static=True)

    @classmethod
    def straight(cls, end: Float[Array, "2"]) -> "WaysToEnd":
        """Straight ways, without obstacles."""
        zeros = jnp.zeros((1,), end.dtype)
        index = jnp.zeros((1,), jnp.int32)
        return cls(end[None], index, zeros, index[None], jnp.zeros_like(end), jnp.ones_like(zeros[0]), 1)

    def distance(self, points: Float[Array, "*N 2"]) -> Float[Array, "*N"]:
        """Length of the shortest way from each point, m."""
        first = self._first(points)
        away = points - self.corners[first]
        return jnp.sqrt(away[..., 0] ** 2 + away[..., 1] ** 2) + self.rest[first]

    def way(self, point: Float[Array, "2"]) -> Float[Array, "L 2"]:
        """The shortest way from a point, as a polyline of `legs + 1` points; the end point is repeated."""
        corner = self._first(point)
        points = [point]
        for _ in range(self.legs):
            points.append(self.corners[corner])
            corner = self.following[corner]
        return jnp.stack(points)

    def drive(self, pose: Pose, path: Path) -> tuple[Drive, Float[Array, ""]]:
        """The part of the way from a pose that is as long as a path, and the distance left to the end.

        Poses are as far apart as those of the path, but for corners. Those beyond the end are not driven.
        """
        way, size = self.way(pose[:2]), path.shape[0]
        step = lengths_along(jnp.pad(path[:, :2], ((1, 0), (0, 0))))[-1] / size
        index = jnp.arange(1, size + 1, dtype=jnp.int32)
        points, driven = points_along(way, step * index.astype(step.dtype), step)
        total = lengths_along(way)[-1]
        rest = jnp.maximum(total - driven[-1], 0.0)
        # The first pose at the end is driven, and those after it repeat it.
        before = jnp.concatenate([jnp.zeros((1,), driven.dtype), driven[:-1]])
        is_driven = before < total * (1.0 - ROUNDING) - ROUNDING
        poses = jnp.concatenate([points, headings_along(pose, points)[:, None]], axis=-1)
        poses = jnp.concatenate([pose[None], poses])[jnp.minimum(index, jnp.sum(is_driven, dtype=jnp.int32))]
        never = jnp.zeros((), bool)
        return Drive(poses, is_driven, never, never), jnp.where(rest <= ROUNDING * (1.0 + total), 0.0, rest)

    def _first(self, points: Float[Array, "*N 2"]) -> Int[Array, "*N"]:
        height, width = self.first.shape
        column = jnp.round((points[..., 0] - self.origin[0]) / self.spacing).astype(jnp.int32)
        row = jnp.round((points[..., 1] - self.origin[1]) / self.spacing).astype(jnp.int32)
        return self.first[jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)]
