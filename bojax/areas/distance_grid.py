"""The signed distance to the border of an area as a table on the device."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bojax.areas.area import Area


class DistanceGrid(eqx.Module):
    """Signed distance to the border of an area on a regular grid, m; negative outside.

    It costs the same for every outline: four values are read at each point.

    Attributes:
        values: Distances at the grid points; the first axis is y, the second x, both increasing.
        origin: Position of `values[0, 0]`, m.
        spacing: Distance between two grid points, m.
    """

    values: Float[Array, "H W"]
    origin: Float[Array, "2"]
    spacing: Float[Array, ""]

    @classmethod
    def of(cls, area: Area, spacing: float) -> "DistanceGrid":
        """The distances to the border of an area, on a grid that extends beyond it by two cells.

        Raises:
            ValueError: The grid would have too many points.
        """
        values, origin = area.distance_table(spacing)
        return cls(jnp.asarray(values), jnp.asarray(origin), jnp.asarray(float(spacing)))

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
