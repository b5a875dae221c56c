"""Fields from data: values on a grid, or measurements at scattered points."""

import jax.numpy as jnp
import numpy as np
from jax.scipy.ndimage import map_coordinates
from jaxtyping import Array, Float, Scalar
from scipy.interpolate import griddata
from scipy.ndimage import distance_transform_edt
from typing_extensions import override

from bojax.fields.base import Field
from bojax.fields.raster_files import read_local_points, read_raster


class _Table(Field):
    """Bilinear interpolation of values on a regular grid, extended by the values on its border."""

    table: Float[Array, "H W"]  # values; the first axis is y, the second x, both increasing
    extent: Float[Array, "4"]

    @override
    def __call__(self, x: Float[Array, "2"]) -> Scalar:
        low, high = self.extent[:2], self.extent[2:]
        cells = jnp.asarray([self.table.shape[1] - 1, self.table.shape[0] - 1], x.dtype)
        column, row = (x - low) / (high - low) * cells
        return map_coordinates(self.table, [row, column], order=1, mode="nearest")


class GridField(_Table):
    """Values on a regular grid, from a file.

    Settings: `bojax.fields.settings.Grid`.
    """

    def __init__(
        self, file: str, extent: Float[Array, "4"], sha256: str | None = None, holes: str = "refuse"
    ):
        """Read the grid from a file; `sha256` and `holes` are checked with the settings.

        Cells without data have the value of the nearest cell with data.
        """
        raster = read_raster(file)
        values = raster.values
        if raster.is_hole.any():
            nearest = distance_transform_edt(raster.is_hole, return_distances=False, return_indices=True)
            values = values[tuple(np.asarray(nearest))]
        self.table = jnp.asarray(values, extent.dtype)
        self.extent = extent


class ScatteredField(_Table):
    """Measurements at scattered points: linear interpolation between them, the nearest one outside.

    The interpolation is evaluated once, on a grid over the extent.

    Settings: `bojax.fields.settings.Scattered`.
    """

    def __init__(
        self, file: str, extent: Float[Array, "4"], resolution: int = 101, sha256: str | None = None
    ):
        """Read rows of x, y and value from a file."""
        rows = read_local_points(file)
        low_x, low_y, high_x, high_y = np.asarray(extent)
        x, y = np.meshgrid(np.linspace(low_x, high_x, resolution), np.linspace(low_y, high_y, resolution))
        nearest = griddata(rows[:, :2], rows[:, 2], (x, y), method="nearest")
        table = nearest
        if len(rows) >= 4 and np.linalg.matrix_rank(rows[:, :2] - rows[0, :2]) == 2:
            table = griddata(rows[:, :2], rows[:, 2], (x, y), method="linear")
            table = np.where(np.isfinite(table), table, nearest)
        self.table = jnp.asarray(table, extent.dtype)
        self.extent = extent
