"""Values on a regular grid with holes, and where the grid lies on the Earth."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from bojax.models.settings import GREATEST

if TYPE_CHECKING:
    import numpy as np

NO_DATA = (-9999.0, -99999.0, -999999.0, -32768.0, 9.969209968386869e36, 1e20)
"""Values that programs write for missing data. Numbers above `LARGEST` in magnitude count as missing too."""

LARGEST = 1e30
"""Largest magnitude of a measured value."""

DEGREES = "EPSG:4326"
"""Longitude and latitude."""


@dataclass(frozen=True, eq=False)
class Raster:
    """Values on a regular grid."""

    values: "np.ndarray"  # `[H, W]`, NaN in holes; the first axis is y, the second x
    x: "np.ndarray"  # positions of the columns, increasing, in the unit of `crs`
    y: "np.ndarray"  # positions of the rows, increasing
    crs: str | None = None  # coordinate reference system; None for metres without a place on the Earth
    step: int = 1  # number of cells of the file, along each axis, that one cell stands for
    notes: tuple[str, ...] = ()  # what a user should know of how it was read, a sentence each
    label: str = ""  # name of the values, with their unit in parentheses; empty if the file has none

    @property
    def is_hole(self) -> "np.ndarray":
        """Whether each cell has no data."""
        import numpy as np

        return np.isnan(self.values)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """`(x_min, y_min, x_max, y_max)` of the outermost cell centres."""
        return float(self.x[0]), float(self.y[0]), float(self.x[-1]), float(self.y[-1])

    @property
    def cells(self) -> "tuple[np.ndarray, np.ndarray]":
        """Centres `[N, 2]` of the cells with data, and their values `[N]`."""
        import numpy as np

        x, y = np.meshgrid(self.x, self.y)
        has_data = ~self.is_hole
        return np.stack([x[has_data], y[has_data]], axis=1), self.values[has_data]

    def thinned(self, most: int) -> "Raster":
        """The raster, or every nth row and column of it so that at most `most` cells remain."""
        step = thinning(self.values.shape, most)
        return replace(
            self,
            values=self.values[::step, ::step],
            x=self.x[::step],
            y=self.y[::step],
            step=self.step * step,
        )


def thinning(shape: tuple[int, ...], most: int) -> int:
    """The smallest n for which every nth row and column are at most `most` cells."""
    step = 1
    while -(-shape[0] // step) * -(-shape[1] // step) > most:
        step += 1
    return step


def regular(values: "np.ndarray", x: "np.ndarray", y: "np.ndarray", crs: str | None, file: str) -> Raster:
    """A raster from values and the positions of their columns and rows, in either direction.

    Where the positions are not evenly spaced, as the latitudes of a map in the Mercator projection, each row
    or column of the raster is the nearest one of the file. Missing data become holes.
    """
    import numpy as np

    values = with_holes(np.array(values, float))
    if min(values.shape) < 2:
        raise ValueError(
            f"{file}: got a grid of {values.shape[0]} x {values.shape[1]}; allowed: at least 2 x 2"
        )
    axes = []
    for axis, positions in enumerate((np.asarray(y, float), np.asarray(x, float))):
        steps = np.diff(positions)
        if not np.isfinite(positions).all() or not ((steps > 0).all() or (steps < 0).all()):
            raise ValueError(f"{file}: the positions of the {('rows', 'columns')[axis]} are not in order")
        if positions[0] > positions[-1]:
            positions, values = positions[::-1], np.flip(values, axis)
        even = np.linspace(positions[0], positions[-1], len(positions))
        if np.abs(even - positions).max() > 0.01 * (even[1] - even[0]):
            middles = (positions[1:] + positions[:-1]) / 2
            values = np.take(values, np.searchsorted(middles, even), axis)
        axes.append(even)
    if np.isnan(values).all():
        raise ValueError(f"{file}: no cell has data")
    largest = np.nanmax(np.abs(values))
    if largest > GREATEST:
        raise ValueError(f"{file}: got {largest:g}; allowed: numbers up to {GREATEST:g} in magnitude")
    return Raster(values, axes[1], axes[0], crs)


def with_holes(values: "np.ndarray") -> "np.ndarray":
    """The values, with NaN for those that stand for missing data."""
    import numpy as np

    is_missing = np.isin(values, NO_DATA) | (np.abs(values) > LARGEST)
    return np.where(is_missing, np.nan, values)
