"""The shortest ways in an area from everywhere to one point, as a table of the next corner of each."""

from typing import Any, NamedTuple

import numpy as np
import shapely
from scipy.ndimage import distance_transform_edt
from scipy.sparse.csgraph import dijkstra
from shapely.geometry.base import BaseGeometry

from bojax.areas.area import longer_side
from bojax.areas.transfers import Transfers

CELLS = 128
"""Cells along the longer side of the table."""


class _Tree(NamedTuple):
    """Corners and last the point, for each the index of the next one and the distance to the point."""

    corners: np.ndarray
    following: np.ndarray
    rest: np.ndarray

    def reduced(self, is_kept: np.ndarray) -> tuple["_Tree", np.ndarray]:
        """The tree of some of the corners, with which the next ones are kept, and the new index of each."""
        renumbered = np.cumsum(is_kept) - 1
        following = renumbered[self.following[is_kept]]
        return _Tree(self.corners[is_kept], following, self.rest[is_kept]), renumbered


def shortest_ways(shape: BaseGeometry, end: np.ndarray) -> dict[str, Any]:
    """The shortest ways in a polygon to a point `[2]` in it: fields of `WaysToEnd` but for its `slack`."""
    transfers = Transfers(shape)
    x_min, y_min, x_max, y_max = shape.bounds
    spacing = longer_side(shape.bounds) / CELLS
    columns, rows = (
        low + spacing * np.arange(int(np.ceil((high - low) / spacing)) + 1)
        for low, high in ((x_min, x_max), (y_min, y_max))
    )
    x, y = np.meshgrid(columns, rows)
    is_inside = shapely.intersects_xy(shape, x, y)
    points = np.stack([x[is_inside], y[is_inside]], axis=1)
    if transfers.has_few_corners:
        tree = _by_sight(transfers, end)
        found = _first_in_sight(transfers, points, tree)
    else:
        tree, found = _by_triangles(transfers, end, points)
    first = np.full(x.shape, len(tree.rest) - 1)
    first[is_inside] = found
    # A position beside the border may be nearest to a grid point outside.
    nearest = distance_transform_edt(~is_inside, return_distances=False, return_indices=True)
    first = first[tuple(np.asarray(nearest))]
    chains = [np.arange(len(tree.rest))]
    while np.any(chains[-1][first] != len(tree.rest) - 1):
        chains.append(tree.following[chains[-1]])
    table = {"chains": np.stack(chains, axis=1), "first": first}
    place = {"origin": np.array([x_min, y_min]), "spacing": spacing}
    return {"corners": tree.corners, "rest": tree.rest, **table, **place}


def _by_sight(transfers: Transfers, end: np.ndarray) -> _Tree:
    """The corners from which the point is reached in the visibility graph."""
    corners, lengths = transfers.graph
    number = len(corners)
    apart = np.linalg.norm(corners - end, axis=1)
    is_clear = transfers.are_clear(np.broadcast_to(end, corners.shape), corners) if number else apart > 0.0
    whole = np.full((number + 1, number + 1), np.inf)
    whole[:number, :number] = lengths
    whole[number, :number] = whole[:number, number] = np.where(is_clear, np.maximum(apart, 1e-300), np.inf)
    rest, before = dijkstra(whole, indices=number, return_predecessors=True)
    before[number] = number
    tree, _ = _Tree(np.concatenate([corners, end[None]]), before, rest).reduced(np.isfinite(rest))
    return tree


def _first_in_sight(transfers: Transfers, points: np.ndarray, tree: _Tree) -> np.ndarray:
    """The first corner on the shortest way from each point: the one of least total length in sight."""
    totals = np.linalg.norm(points[:, None] - tree.corners, axis=2) + tree.rest
    order = np.argsort(totals, axis=1)
    first, is_open = order[:, 0].copy(), np.arange(len(points))
    for rank in range(order.shape[1]):
        candidates = order[is_open, rank]
        is_clear = transfers.are_clear(points[is_open], tree.corners[candidates])
        first[is_open[is_clear]] = candidates[is_clear]
        is_open = is_open[~is_clear]
        if not len(is_open):
            break
    return first


def _by_triangles(transfers: Transfers, end: np.ndarray, points: np.ndarray) -> tuple[_Tree, np.ndarray]:
    """Ways along edges of triangles, shortened by line of sight, and the first corner from each point."""
    corners, following, rest = transfers.triangles.tree(end, transfers.reach)

    def sees(first: np.ndarray, last: np.ndarray) -> bool:
        return bool(transfers.are_clear(first[None], last[None])[0])

    for corner in np.argsort(rest)[1:]:  # those that follow are done
        after = following[corner]
        while following[after] != after and sees(corners[corner], corners[following[after]]):
            after = following[after]
        following[corner] = after
        rest[corner] = np.linalg.norm(corners[corner] - corners[after]) + rest[after]
    around = transfers.triangles.around_each(points, transfers.reach)
    totals = np.linalg.norm(points[:, None] - corners[around], axis=2) + rest[around]
    first = np.take_along_axis(around, np.argmin(totals, axis=1)[:, None], axis=1)[:, 0]
    is_open = np.arange(len(points))
    while len(is_open):
        beyond = following[first[is_open]]
        is_clear = transfers.are_clear(points[is_open], corners[beyond])
        is_clear &= beyond != first[is_open]
        is_open = is_open[is_clear]
        first[is_open] = beyond[is_clear]
    is_used = np.zeros(len(rest), bool)
    is_used[-1], now = True, np.unique(first)
    while not is_used[now].all():
        is_used[now] = True
        now = np.unique(following[now])
    tree, renumbered = _Tree(corners, following, rest).reduced(is_used)
    return tree, renumbered[first]
