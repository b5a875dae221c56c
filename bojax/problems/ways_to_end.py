"""The shortest ways to the point at which a survey must end."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bojax.areas.outlined import OutlinedArea
from bojax.models.checks import compiled_if_known, is_known
from bojax.motions.base import Path, Pose
from bojax.motions.polylines import headings_along, lengths_along, points_along
from bojax.problems.budgets import check_reach
from bojax.problems.walls import ROUNDING, Boxes, Drive, is_rounding


class WaysToEnd(eqx.Module):
    """Shortest ways to the end point from everywhere, as a table of the next corner of each.

    A shortest way is a polyline: straight from a position to the first corner of an obstacle at which it
    bends, or to the end point, and on from there. A lookup of the first corner makes the distance exact and
    as cheap as a straight line, whatever the obstacles. From a position between two grid points, the first
    leg may cut a corner, or a wall narrower than their distance, and the distance is then off.
    """

    corners: Float[Array, "C 2"]  # where ways bend, and last the end point, m
    # Indices of the corners on the way from each, itself first; the end point is repeated
    chains: Int[Array, "C L"]
    rest: Float[Array, "C"]  # distance from each corner to the end point along its way, m
    # Index of the first corner for positions around each grid point; the first axis is y
    first: Int[Array, "H W"]
    origin: Float[Array, "2"]  # position of `first[0, 0]`, m
    spacing: Float[Array, ""]  # distance between two grid points, m
    slack: Float[Array, ""]  # distance that is reserved for errors of the lookup, m

    @classmethod
    def straight(cls, end: Float[Array, "2"]) -> "WaysToEnd":
        """Straight ways, without obstacles."""
        zeros = jnp.zeros((1,), end.dtype)
        index = jnp.zeros((1, 1), jnp.int32)
        origin, one, none = jnp.zeros_like(end), jnp.ones_like(zeros[0]), zeros[0]
        return cls(end[None], index, zeros, index, origin, one, none)

    def reserve(self, points: Float[Array, "*N 2"]) -> Float[Array, "*N"]:
        """Distance that has to be left at each point to reach the end point, m."""
        return self.distance(points) + self.slack

    def must_return(self, point: Float[Array, "2"], left: Float[Array, ""]) -> Bool[Array, ""]:
        """Whether no more than the reserve is left at a point."""
        return left <= (self.reserve(point) + self.slack) * (1.0 + ROUNDING) + ROUNDING

    @compiled_if_known
    def distance(self, points: Float[Array, "*N 2"]) -> Float[Array, "*N"]:
        """Length of the shortest way from each point, m."""
        first = self._first(points)
        away = points - self.corners[first]
        return jnp.sqrt(away[..., 0] ** 2 + away[..., 1] ** 2) + self.rest[first]

    def way(self, point: Float[Array, "2"]) -> Float[Array, "W 2"]:
        """The shortest way from a point, as a polyline of L + 1 points; the end point is repeated."""
        return jnp.concatenate([point[None], self.corners[self.chains[self._first(point)]]])

    def drive(self, pose: Pose, path: Path) -> tuple[Drive, Float[Array, ""]]:
        """The part of the way from a pose that is as long as a path, and the distance left to the end.

        Poses are as far apart as those of the path, but for corners. Those beyond the end are not driven. For
        a path that stays where it is, the part is the whole way.
        """
        way, size = self.way(pose[:2]), path.shape[0]
        length, total = lengths_along(jnp.pad(path[:, :2], ((1, 0), (0, 0))))[-1], lengths_along(way)[-1]
        step = jnp.where(is_rounding(length, pose), total, length) / size
        index = jnp.arange(1, size + 1, dtype=jnp.int32)
        points, driven = points_along(way, step * index.astype(step.dtype), step)
        rest = jnp.maximum(total - driven[-1], 0.0)
        # The first pose at the end is driven, and those after it repeat it.
        before = jnp.concatenate([jnp.zeros((1,), driven.dtype), driven[:-1]])
        is_driven = before < total * (1.0 - ROUNDING) - ROUNDING
        poses = jnp.concatenate([points, headings_along(pose, points)[:, None]], axis=-1)
        poses = jnp.concatenate([pose[None], poses])[jnp.minimum(index, jnp.sum(is_driven, dtype=jnp.int32))]
        never = jnp.zeros((), bool)
        is_there = rest <= ROUNDING * (1.0 + total)
        return Drive(poses, is_driven, never, never), jnp.where(is_there, 0.0, rest + self.slack)

    def _first(self, points: Float[Array, "*N 2"]) -> Int[Array, "*N"]:
        height, width = self.first.shape
        column = jnp.round((points[..., 0] - self.origin[0]) / self.spacing).astype(jnp.int32)
        row = jnp.round((points[..., 1] - self.origin[1]) / self.spacing).astype(jnp.int32)
        return self.first[jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)]


def ways_around(
    end: Float[Array, "2"], domain: Float[Array, "4"], walls: Boxes | None, area: OutlinedArea | None
) -> WaysToEnd:
    """The shortest ways around walls and in an area, computed on the host.

    Raises:
        ValueError: The end point is not in the area, or the values are traced.
    """
    if walls is None and area is None:
        return WaysToEnd.straight(end)
    import shapely  # not at the start of every run

    from bojax.areas.shapes import polygons_of, to_shape
    from bojax.areas.shortest_ways import shortest_ways

    if not is_known((end, domain, walls, area)):
        raise ValueError("end: cannot be traced with walls or an area; allowed: pass `ways` as well")
    free = shapely.box(*np.asarray(domain, float).tolist())
    if area is not None:
        free = shapely.intersection(free, to_shape(area.area))
    for wall in () if walls is None else np.asarray(walls, float):
        free = shapely.difference(free, shapely.box(*wall.tolist()))
    target = np.asarray(end, float)
    parts = [part for part in polygons_of(free) if shapely.dwithin(part, shapely.Point(target), 1e-6)]
    if not parts:
        raise ValueError(f"end: ({target[0]:g}, {target[1]:g}) is not in the area, or lies in a hole of it")
    ways = shortest_ways(parts[0], target)
    ways["slack"] = 0.1 * ways["spacing"]
    is_index = {"chains", "first"}
    return WaysToEnd(
        **{name: jnp.asarray(x, jnp.int32 if name in is_index else end.dtype) for name, x in ways.items()}
    )


def check_budget(
    ways: WaysToEnd,
    starts: Float[Array, "N 2"],
    is_free: Bool[Array, "N"],
    budget: Float[Array, ""] | None,
    speed: Float[Array, ""] | None,
) -> None:
    """Refuse a budget below the longest way from the free starts to the end point, or raise ValueError.

    Nothing is checked of traced values.
    """
    if budget is None or not is_known((ways, starts, is_free, budget, speed)):
        return
    least = float(jnp.max(jnp.where(is_free, ways.distance(starts), 0.0)))
    check_reach(float(budget), least, None if speed is None else float(speed), len(starts) == 1)
