"""Shortest paths in an area, around its holes and no-go zones."""

from functools import cached_property

import numpy as np
import shapely
from scipy.sparse.csgraph import dijkstra
from shapely.geometry.base import BaseGeometry

from bojax.areas.area import longer_side
from bojax.areas.shapes import rings_of
from bojax.areas.triangles import Triangles, nodes_to

MOST_CORNERS = 400  # of the visibility graph


class Transfers:
    """Shortest paths between points of a shape, by its visibility graph.

    A shortest path bends only at corners of the border where the area lies on the outside of the turn. If
    there are more than `MOST_CORNERS` of them, paths are found along the edges of a triangulation and
    shortened by line of sight instead: they are a few per cent longer than the shortest.
    """

    def __init__(self, shape: BaseGeometry, clearance: float = 0.0):
        """Prepare the paths in `shape`; paths may run along its border.

        With a clearance, they bend at least so far from it, m, where there is room for that.
        """
        self._tolerance = max(1e-9 * longer_side(shape.bounds), 1e-6)  # as of `check_inside`
        self._shape = shape.buffer(self._tolerance)
        shapely.prepare(self._shape)
        self._simple = shape.buffer(-clearance, quad_segs=2) if clearance > 0.0 else shape
        self.reach = self._tolerance + 2.0 * clearance  # of a triangle
        self._without_clearance = Transfers(shape) if clearance > 0.0 else None

    def are_clear(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Whether the straight line from each row of `first [N, 2]` to that of `last` stays in the shape."""
        lines = shapely.linestrings(np.stack([first, last], axis=1))
        return np.asarray(shapely.covers(self._shape, lines))

    def path(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Waypoints `[W, 2]` of the shortest path between two points, which are its first and last row.

        Raises:
            ValueError: No path joins them.
        """
        if self.are_clear(first[None], last[None])[0]:
            return np.stack([first, last])
        path = self._seen(first, last) if self.has_few_corners else self._shortened(first, last)
        if path is None and self._without_clearance is not None:
            return self._without_clearance.path(first, last)
        if path is None:
            raise ValueError(f"no path in the area joins {_shown(first)} and {_shown(last)}")
        return path

    def _seen(self, first: np.ndarray, last: np.ndarray) -> np.ndarray | None:
        """The shortest path in the visibility graph."""
        corners, lengths = self.graph
        number = len(corners)
        ends = np.stack([first, last])
        whole = np.full((number + 2, number + 2), np.inf)
        whole[:number, :number] = lengths
        for index, end in enumerate(ends):
            apart = np.linalg.norm(corners - end, axis=1)
            is_clear = self.are_clear(np.broadcast_to(end, corners.shape), corners)
            whole[number + index, :number] = whole[:number, number + index] = np.where(
                is_clear, apart, np.inf
            )
        distance, before = dijkstra(whole, indices=number, return_predecessors=True)
        if not np.isfinite(distance[number + 1]):
            return None
        return np.concatenate([corners, ends])[nodes_to(number + 1, before)]

    def _shortened(self, first: np.ndarray, last: np.ndarray) -> np.ndarray | None:
        """A way along edges of triangles: from each waypoint to the last one in sight."""
        way = self.triangles.way(first, last, self.reach)
        if way is None:
            return None
        kept = [0]
        while kept[-1] < len(way) - 1:
            kept.append(self._last_in_sight(way, kept[-1]))
        return way[kept]

    def _last_in_sight(self, way: np.ndarray, at: int) -> int:
        """The last waypoint that one sees, by growing parts of the way until one has none in sight."""
        last, begin, size = at + 1, at + 2, 8
        while begin < len(way):
            farther = way[begin : begin + size]
            seen = np.flatnonzero(self.are_clear(np.broadcast_to(way[at], farther.shape), farther))
            if not len(seen):
                break
            last, begin, size = begin + int(seen[-1]), begin + size, 2 * size
        return last

    @property
    def has_few_corners(self) -> bool:
        """Whether paths are those of the visibility graph, and not of the triangulation."""
        return len(self.corners) <= MOST_CORNERS

    @cached_property
    def triangles(self) -> Triangles:
        """The triangulation of the shape."""
        return Triangles(self._simple)

    @cached_property
    def corners(self) -> np.ndarray:
        """The corners `[C, 2]` at which shortest paths bend."""
        return _outer_corners(self._simple)

    @cached_property
    def graph(self) -> tuple[np.ndarray, np.ndarray]:
        """The corners at which paths bend, and the lengths between those that see each other."""
        corners = self.corners
        lengths = np.linalg.norm(corners[:, None] - corners[None], axis=2)
        first, last = np.triu_indices(len(corners), 1)
        is_clear = np.zeros(lengths.shape, bool)
        is_clear[first, last] = self.are_clear(corners[first], corners[last])
        return corners, np.where(is_clear | is_clear.T, lengths, np.inf)


def _outer_corners(shape: BaseGeometry) -> np.ndarray:
    """Corners where the inner angle of the shape exceeds half a turn."""
    corners = []
    for ring in rings_of(shapely.orient_polygons(shape, exterior_cw=False)):
        points = ring[:-1]
        before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
        # The area is on the left of each edge, so that the border turns right around such a corner.
        turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        corners.append(points[turn < 0.0])
    return np.concatenate([*corners, np.empty((0, 2))])


def _shown(point: np.ndarray) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g})"
