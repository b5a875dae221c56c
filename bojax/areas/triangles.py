"""Ways along the edges of triangles that a shape is divided into."""

import numpy as np
import shapely
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from shapely.geometry.base import BaseGeometry

NEAR = 3.0  # lengths of the straight line within which a way is looked for first


class Triangles:
    """The constrained Delaunay triangulation of a shape, whose edges join all corners of each part of it.

    The number of edges is in proportion to that of the corners, unlike in a visibility graph.
    """

    def __init__(self, shape: BaseGeometry):
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(shape))
        self._tree = shapely.STRtree(triangles)
        points = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
        self._corners, index = np.unique(points.reshape(-1, 2), axis=0, return_inverse=True)
        self._triangles = index.reshape(-1, 3)  # of corners
        first, last = self._triangles.ravel(), np.roll(self._triangles, -1, axis=1).ravel()
        both = np.stack([np.append(first, last), np.append(last, first)], axis=1)
        self._edges = np.unique(both, axis=0).T  # the first and the last corner of each, in both directions
        self._lengths = _lengths(self._corners, self._edges)

    def way(self, first: np.ndarray, last: np.ndarray, tolerance: float) -> np.ndarray | None:
        """Waypoints `[W, 2]` of the shortest way along edges between two points, or None if there is none.

        Each point is joined to the corners of its triangle, which may be as far away as the tolerance.
        """
        number = len(self._corners)
        points = np.concatenate([self._corners, [first, last]])
        near_first, near_last = self._around(first, tolerance), self._around(last, tolerance)
        begin = np.concatenate([np.full(len(near_first), number), near_last])
        end = np.concatenate([near_first, np.full(len(near_last), number + 1)])
        lengths = np.concatenate([self._lengths, _lengths(points, np.stack([begin, end]))])
        edges = np.concatenate([self._edges, [begin, end]], axis=1)
        graph = csr_array((lengths, edges), shape=(number + 2, number + 2))
        for limit in (NEAR * float(np.linalg.norm(last - first)), np.inf):
            distance, before = dijkstra(graph, indices=number, limit=limit, return_predecessors=True)
            if np.isfinite(distance[number + 1]):
                return points[nodes_to(number + 1, before)]
        return None

    def tree(self, end: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The shortest ways along edges from all corners to a point.

        Returns:
            The corners and last the point `[C + 1, 2]`, for each the index of the next one, which for the
            point is its own, and the length of the way from it, which is infinite if there is none.
        """
        number, near = len(self._corners), self._around(end, tolerance)
        points = np.concatenate([self._corners, end[None]])
        edges = np.concatenate([self._edges, [np.full(len(near), number), near]], axis=1)
        graph = csr_array((_lengths(points, edges), edges), shape=(number + 1, number + 1))
        rest, following = dijkstra(graph, indices=number, return_predecessors=True)
        following[number] = number
        return points, following, rest

    def around_each(self, points: np.ndarray, tolerance: float) -> np.ndarray:
        """Indices `[N, 3]` of the corners of a triangle that each point is in."""
        of, found = self._tree.query(shapely.points(points), predicate="dwithin", distance=tolerance)
        return self._triangles[found[np.unique(of, return_index=True)[1]]]

    def _around(self, point: np.ndarray, tolerance: float) -> np.ndarray:
        """Indices of the corners of the triangles that a point is in."""
        found = self._tree.query(shapely.Point(point), predicate="dwithin", distance=tolerance)
        return np.unique(self._triangles[found])


def _lengths(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Lengths of edges `[2, E]`, above zero, as an edge of no length would count as none."""
    first, last = points[edges]
    return np.maximum(np.linalg.norm(last - first, axis=1), 1e-300)


def nodes_to(node: int, before: np.ndarray) -> list[int]:
    """Nodes of a path in a graph up to a node, given the node before each."""
    nodes = []
    while node >= 0:
        nodes.append(node)
        node = int(before[node])
    return nodes[::-1]
