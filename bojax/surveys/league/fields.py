"""Fields of the league of surveys, fixed before any route was scored.

Every field lies on 10 x 10 units and is standardised over its area. Real ones are windows of data that two
packages ship: Matplotlib (a digital elevation model and a bathymetry) and iris-sample-data 2.5.2 (UK Open
Government Licence; the sea surface temperature of OSTIA and a brightness temperature that a satellite
measured), which is optional. Land is a hole. Windows were chosen by the share of their cells with data.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.cbook
import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.spatial.distance import cdist

from bojax.areas.area import Area
from bojax.areas.place import shape_of_cells
from bojax.areas.shapes import to_area
from bojax.surveys.model import FieldModel

SIDE = 10.0
VARIANCE, LENGTHSCALE, NOISE_VARIANCE = 0.807, 1.160, 0.0089
"""Of the one process that scores all maps: fitted to 200 heights beside the window of the elevation."""

MODEL = FieldModel(LENGTHSCALE, VARIANCE**0.5, NOISE_VARIANCE**0.5, "the league's")
"""This process; all planners know it."""

SQUARE = Area.rectangle(0.0, 0.0, SIDE, SIDE)
"""The area of every field without holes."""

SAMPLE = "iris_sample_data"
WALLS = ((2.0, 0.0, 2.4, 7.0), (4.6, 3.0, 5.0, 10.0), (7.2, 0.0, 7.6, 4.0), (7.2, 5.5, 7.6, 10.0))
"""Walls of the obstacle course, `(x_min, y_min, x_max, y_max)`."""


@dataclass(frozen=True, eq=False)
class Field:
    """A field to map."""

    name: str
    area: Area  # where it has data
    value: Callable[[np.ndarray], np.ndarray]  # values at points `[N, 2]`
    is_real: bool = False  # whether it was measured

    @property
    def place(self) -> str:
        """Name of the area: fields with equal names share their routes, which do not depend on values."""
        return "square" if self.area is SQUARE else self.name


def has_sample() -> bool:
    """Whether the package of three of the real fields is installed."""
    return importlib.util.find_spec(SAMPLE) is not None


def league() -> list[Field]:
    """All fields; those of iris-sample-data only if the package is installed."""
    dem = _shipped("jacksboro_fault_dem.npz", "elevation")
    sea = _shipped("topobathy.npz", "topo")
    fields = [
        _real("elevation", dem[120:228, 150:284][::-1]),
        _real("bathymetry", sea[:30, :30]),
        _real("coast", np.where(sea[15:45, 75:105] < 0.0, sea[15:45, 75:105], np.nan)),
    ]
    if has_sample():
        clouds, surface = _sampled("toa_brightness_stereographic.nc"), _sampled("ostia_monthly.nc")
        fields += [
            _real("clouds", clouds[30:90, 150:210]),
            _real("pacific", surface[:, 228:240]),
            _real("new-guinea", surface[:, 168:180]),
        ]
    course = SQUARE.without(Area.rectangle(*wall).outline for wall in WALLS)
    return [
        *fields,
        _standardised("sampled", SQUARE, _drawn(1, lambda points: points)),
        _standardised("non-stationary", SQUARE, _drawn(2, _warped)),
        _standardised("course", course, _drawn(3, lambda points: points)),
    ]


def _warped(points: np.ndarray) -> np.ndarray:
    """Positions at which a stationary field varies four times as fast in one corner as in the opposite."""
    return points * (0.5 + 0.75 * points / SIDE)


def _drawn(seed: int, warp: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """A draw from the scoring process at warped positions, on a grid and interpolated."""
    axis = np.linspace(0.0, SIDE, 41)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    scaled = np.sqrt(5.0) * cdist(warp(points), warp(points)) / LENGTHSCALE
    covariance = VARIANCE * (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
    factor = np.linalg.cholesky(covariance + 1e-8 * np.eye(len(points)))
    return _interpolated((factor @ np.random.default_rng(seed).standard_normal(len(points))).reshape(41, 41))


def _real(name: str, values: np.ndarray) -> Field:
    """A field of the cells of a window, the first row at y = 0; NaN is a hole.

    Cells in a hole take the value of the nearest with data, which counts only between two centres.
    """
    is_hole = np.isnan(values)
    nearest: Any = distance_transform_edt(is_hole, return_distances=False, return_indices=True)
    x, y = (np.linspace(0.0, SIDE, size) for size in values.shape[::-1])
    area = to_area(shape_of_cells(x, y, ~is_hole)) if is_hole.any() else SQUARE
    return _standardised(name, area, _interpolated(values[tuple(nearest)]), is_real=True)


def _standardised(
    name: str, area: Area, value: Callable[[np.ndarray], np.ndarray], is_real: bool = False
) -> Field:
    values = value(area.grid(0.1))
    mean, deviation = values.mean(), values.std()
    return Field(name, area, lambda points: (value(points) - mean) / deviation, is_real)


def _interpolated(values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    rows, columns = (np.linspace(0.0, SIDE, size) for size in values.shape)
    interpolate = RegularGridInterpolator((rows, columns), values)
    return lambda points: interpolate(np.clip(points[:, ::-1], 0.0, SIDE))


def _shipped(file: str, name: str) -> np.ndarray:
    archive: Any = matplotlib.cbook.get_sample_data(file)
    return archive[name].astype(float)


def _sampled(file: str) -> np.ndarray:
    """The first band of a file of iris-sample-data; NaN without data."""
    import rasterio

    spec = importlib.util.find_spec(SAMPLE)
    assert spec is not None and spec.origin is not None
    with rasterio.open(Path(spec.origin).parent / "sample_data" / file) as data:
        return data.read(1, masked=True).astype(float).filled(np.nan)
