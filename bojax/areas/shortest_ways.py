"""The shortest ways in an area from everywhere to one point, as a table of the next corner of each."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse.csgraph import dijkstra

from bojax.areas.shapes import shapely_module
from bojax.areas.transfers import Transfers

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

CELLS = 128
"""Cells along the longer side of the table."""


@dataclass(frozen=True, eq=False)
class ShortestWays:
    """Shortest ways to a point, as of `bojax.problems.ways_to_end.WaysToEnd`.

    Attributes:
        corners: Corners of the border at which ways bend, and last the point `[C, 2]`, m.
        following: Index `[C]` of the corner after each; that of the point is its own.
        rest: Distance `[C]` from each corner to the point, m.
        first: Index `[H, W]` of the first corner for positions around each grid point; the first axis is y.
        origin: Position of `first[0, 0]`, m.
        spacing: Distance between two grid points, m.
        legs: Largest number of straight pieces of a way.
    """

    corners: np.ndarray
    following: np.ndarray
    rest: np.ndarray
    first: np.ndarray
    origin: np.ndarray
    spacing: float
    legs: int


def shortest_ways(shape: "BaseGeometry", end: np.ndarray) -> ShortestWays:
    """The shortest ways in a polygon to a point `[2]` in it."""
    transfers = Transfers(shape)
    corners, following, rest = _tree(transfers, end)
    x_min, y_min, x_max, y_max = shape.bounds
    spacing = max(x_max - x_min, y_max - y_min) / CELLS
    columns, rows = (
        low + spacing * np.arange(int(np.ceil((high - low) / spacing)) + 1)
        for low, high in ((x_min, x_max), (y_min, y_max))
    )
    x, y = np.meshgrid(columns, rows)
    is_inside = shapely_module().intersects_xy(shape, x, y)
    first = np.full(x.shape, len(rest) - 1)
    first[is_inside] = _first(transfers, np.stack([x[is_inside], y[is_inside]], axis=1), corners, rest)
    # A position beside the border may be nearest to a grid point outside.
    nearest = distance_transform_edt(~is_inside, return_distances=False, return_indices=True)
    first = first[tuple(np.asarray(nearest))]
    legs = np.ones(len(rest), int)
    for corner in np.argsort(rest):
        if following[corner] != corner:
            legs[corner] = legs[following[corner]] + 1
    origin = np.array([x_min, y_min])
    return ShortestWays(corners, following, rest, first, origin, spacing, int(legs[first].max()))


def _tree(transfers: Transfers, end: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The corners from which the point is reached, and last the point, with `following` and `rest`."""
    corners, lengths = transfers.graph
    number = len(corners)
    apart = np.linalg.norm(corners - end, axis=1)
    is_clear = transfers.are_clear(np.broadcast_to(end, corners.shape), corners) if number else apart > 0.0
    whole = np.full((number + 1, number + 1), np.inf)
    whole[:number, :number] = lengths
    whole[number, :number] = whole[:number, number] = np.where(is_clear, np.maximum(apart, 1e-300), np.inf)
    rest, before = dijkstra(whole, indices=number, return_predecessors=True)
    is_reached = np.isfinite(rest)
    before[number] = number
    renumbered = np.cumsum(is_reached) - 1
    return (
        np.concatenate([corners, end[None]])[is_reached],
        renumbered[before[is_reached]],
        rest[is_reached],
    )


def _first(transfers: Transfers, points: np.ndarray, corners: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """The first corner on the shortest way from each point: the one of least total length in sight."""
    totals = np.linalg.norm(points[:, None] - corners, axis=2) + rest
    order = np.argsort(totals, axis=1)
    first, is_open = order[:, 0].copy(), np.arange(len(points))
    for rank in range(order.shape[1]):
        candidates = order[is_open, rank]
        is_clear = transfers.are_clear(points[is_open], corners[candidates])
        first[is_open[is_clear]] = candidates[is_clear]
        is_open = is_open[~is_clear]
        if not len(is_open):
            break
    return first
