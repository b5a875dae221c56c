"""Shortest paths in an area, around its holes and no-go zones."""

from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.sparse.csgraph import dijkstra

from bojax.areas.shapes import rings_of, shapely_module

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

MOST_CORNERS = 400  # of the graph; the outline is simplified until it has no more


class Ways(Protocol):
    """Ways between two points, as of `Transfers`."""

    def are_clear(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Whether the straight line from each row of `first [N, 2]` to that of `last` stays in the area."""
        ...

    def path(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Waypoints `[W, 2]` of a way between two points, or a `ValueError` if there is none."""
        ...


class Transfers:
    """Shortest paths between points of a shape, by its visibility graph.

    A shortest path bends only at corners of the border where the area lies on the outside of the turn.
    """

    def __init__(self, shape: "BaseGeometry"):
        """Prepare the paths in `shape`; paths may run along its border."""
        shapely = shapely_module()
        x_min, y_min, x_max, y_max = shape.bounds
        self._tolerance = 1e-9 * max(x_max - x_min, y_max - y_min)
        self._shape = shape.buffer(self._tolerance)
        shapely.prepare(self._shape)
        self._simple = shape

    def are_clear(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Whether the straight line from each row of `first [N, 2]` to that of `last` stays in the shape."""
        shapely = shapely_module()
        lines = shapely.linestrings(np.stack([first, last], axis=1))
        return np.asarray(shapely.covers(self._shape, lines))

    def path(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Waypoints `[W, 2]` of the shortest path between two points, which are the first and the last row.

        Raises:
            ValueError: No path joins them.
        """
        if self.are_clear(first[None], last[None])[0]:
            return np.stack([first, last])
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
            raise ValueError(f"no path in the area joins {_shown(first)} and {_shown(last)}")
        nodes, node = [], number + 1
        while node >= 0:
            nodes.append(node)
            node = int(before[node])
        return np.concatenate([corners, ends])[nodes[::-1]]

    @cached_property
    def graph(self) -> tuple[np.ndarray, np.ndarray]:
        """The corners `[C, 2]` at which paths bend, and the lengths between those that see each other."""
        corners = self._bends()
        lengths = np.linalg.norm(corners[:, None] - corners[None], axis=2)
        first, last = np.triu_indices(len(corners), 1)
        is_clear = np.zeros(lengths.shape, bool)
        is_clear[first, last] = self.are_clear(corners[first], corners[last])
        return corners, np.where(is_clear | is_clear.T, lengths, np.inf)

    def _bends(self) -> np.ndarray:
        """Corners of the border that a path can turn around.

        An outline with too many corners is simplified after it was drawn in, so that it stays in the shape.
        """
        shapely = shapely_module()
        bends = _outer_corners(self._simple)
        x_min, y_min, x_max, y_max = self._simple.bounds
        tolerance = 1e-3 * max(x_max - x_min, y_max - y_min)
        while len(bends) > MOST_CORNERS:
            drawn_in = self._simple.buffer(-tolerance, join_style="mitre")
            bends = _outer_corners(drawn_in.simplify(tolerance / 2))
            tolerance *= 1.5
        shapely.prepare(self._shape)
        return bends


def _outer_corners(shape: "BaseGeometry") -> np.ndarray:
    """Corners where the inner angle of the shape exceeds half a turn."""
    shapely = shapely_module()
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
