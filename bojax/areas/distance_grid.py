"""The signed distance to the border of an area as a table on the device."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from bojax.areas.area import Area, Ring, edges_of

MOST_PAIRS = 8_000_000
"""Pairs of a point and an edge up to which all distances are computed; beyond, the nearest is searched."""

FINENESS = 8  # points of the border per cell that the search finds


class DistanceGrid(eqx.Module):
    """Signed distance to the border of an area on a regular grid, m; negative outside.

    It costs the same for every outline: four values are read at each point.
    """

    # Distances at the grid points; the first axis is y, the second x, both increasing
    values: Float[Array, "H W"]
    origin: Float[Array, "2"]  # position of `values[0, 0]`, m
    spacing: Float[Array, ""]  # distance between two grid points, m

    @classmethod
    def of(cls, area: Area, spacing: float) -> "DistanceGrid":
        """The distances to the border of an area, on a grid that extends beyond it by two cells."""
        columns, rows = area.axes(spacing)
        origin = jnp.asarray([columns[0], rows[0]])
        return cls(jnp.asarray(_table(area, columns, rows)), origin, jnp.asarray(float(spacing)))

    def __call__(self, points: Float[Array, "*N 2"]) -> Float[Array, "*N"]:
        """Distance at points, interpolated bilinearly; differentiable.

        Beyond the grid, the distance to the grid is subtracted from the value on its edge.
        """
        height, width = self.values.shape
        x = (points[..., 0] - self.origin[0]) / self.spacing
        y = (points[..., 1] - self.origin[1]) / self.spacing
        column, x_share, x_beyond = _cell(x, width)
        row, y_share, y_beyond = _cell(y, height)
        lower = _blend(self.values[row, column], self.values[row, column + 1], x_share)
        upper = _blend(self.values[row + 1, column], self.values[row + 1, column + 1], x_share)
        return _blend(lower, upper, y_share) - self.spacing * _length(x_beyond, y_beyond)


def _cell(
    x: Float[Array, "*N"], size: int
) -> tuple[Int[Array, "*N"], Float[Array, "*N"], Float[Array, "*N"]]:
    """The cell of a coordinate, the position in it from 0 to 1, and the distance beyond the grid."""
    inside = jnp.clip(x, 0.0, size - 1.0)
    cell = jnp.minimum(jnp.floor(inside), size - 2.0)
    return cell.astype(jnp.int32), inside - cell, x - inside


def _blend(
    first: Float[Array, "*N"], second: Float[Array, "*N"], share: Float[Array, "*N"]
) -> Float[Array, "*N"]:
    return (1.0 - share) * first + share * second


def _length(x: Float[Array, "*N"], y: Float[Array, "*N"]) -> Float[Array, "*N"]:
    squared = x**2 + y**2
    is_zero = squared == 0.0  # where a root has an infinite gradient
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, squared)))


def _table(area: Area, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Signed distances `[H, W]` of grid points, exact, or for many edges to within 1/16 of a cell."""
    corners = sum(len(ring) for zone in (area.outline, *area.avoid) for ring in zone)
    if len(columns) * len(rows) * corners <= MOST_PAIRS:
        x, y = np.meshgrid(columns, rows)
        return area.distances(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(x.shape)
    distances = _searched(area.outline, columns, rows)
    for zone in area.avoid:
        distances = np.minimum(distances, -_searched(zone, columns, rows))
    return distances


def _searched(rings: Sequence[Ring], columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Distances to the edge with the nearest of many points of the border, negative outside the rings."""
    first, last = edges_of(rings)
    along = last - first
    lengths = np.linalg.norm(along, axis=1)
    counts = 1 + np.ceil(lengths * FINENESS / (columns[1] - columns[0])).astype(int)
    edge = np.repeat(np.arange(len(first)), counts)
    share = (np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[edge]
    x, y = np.meshgrid(columns, rows)
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    nearest = edge[KDTree(first[edge] + share[:, None] * along[edge]).query(points)[1]]
    offset, way = points - first[nearest], along[nearest]
    shares = np.sum(offset * way, axis=1) / np.maximum(lengths[nearest] ** 2, np.finfo(float).tiny)
    distances = np.linalg.norm(offset - np.clip(shares, 0.0, 1.0)[:, None] * way, axis=1)
    return np.where(_are_inside(first, last, columns, rows), 1.0, -1.0) * distances.reshape(x.shape)


def _are_inside(first: np.ndarray, last: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Whether a ray in the direction of x crosses the edges an odd number of times, row by row."""
    inside = np.zeros((len(rows), len(columns)), bool)
    for index, y in enumerate(rows):
        spans = (first[:, 1] > y) != (last[:, 1] > y)
        begin, end = first[spans], last[spans]
        slopes = (end[:, 0] - begin[:, 0]) / (end[:, 1] - begin[:, 1])
        crossings = np.sort(begin[:, 0] + (y - begin[:, 1]) * slopes)
        inside[index] = (len(crossings) - np.searchsorted(crossings, columns, side="right")) % 2 == 1
    return inside
