"""What is surveyed: an area from a file or a size, in metres, with its place on the Earth."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from bojax.areas import polygons
from bojax.areas.area import Area, check_inside
from bojax.areas.shapes import to_area, to_shape
from bojax.fields.data import Points, in_file, split_choice
from bojax.fields.projection import TOLERANCE, Projection
from bojax.fields.raster import Raster
from bojax.fields.raster_files import SUFFIXES as RASTERS
from bojax.fields.raster_files import frame_of, read_raster

MOST_CELLS = 1_000_000
"""Cells of a raster; larger ones are thinned."""

MOST_DRAWN = 20_000
"""Values of a file that are drawn."""

_SIZE = re.compile(r"([\d.eE+]+)\s*(k?m)?\s*x\s*([\d.eE+]+)\s*(k?m)?")


@dataclass(frozen=True, eq=False)
class Values:
    """Values of a file, thinned for drawing."""

    file: str  # its name
    points: np.ndarray  # positions `[N, 2]`, m
    values: np.ndarray  # values `[N]`
    label: str = ""  # name of the values, with their unit in parentheses; empty if the file has none


@dataclass(frozen=True, eq=False)
class Place:
    """An area in metres, and where it lies.

    Attributes:
        name: What it was read from.
        area: The area, in the frame of `projection`.
        projection: The frame.
        notes: What a user should know of how it was read, a sentence each.
        values: The values of a raster.
    """

    name: str
    area: Area
    projection: Projection
    notes: tuple[str, ...] = ()
    values: Values | None = None

    def point(self, given: Sequence[float], name: str) -> np.ndarray:
        """A point of the area given in the coordinates of its file, in metres.

        Raises:
            ValueError: It is not in the area; the message begins with `name`.
        """
        point = self.projection.to_local(np.asarray(given, float))
        check_inside(self.area, point, name, given, self.bounds)
        return point

    def noted(self, note: str) -> "Place":
        """The place with one more note."""
        return replace(self, notes=(*self.notes, note))

    @property
    def size(self) -> float:
        """Its area, m^2."""
        return float(to_shape(self.area).area)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """`(x_min, y_min, x_max, y_max)` in the coordinates of the file."""
        low, high = self.projection.from_local(np.array(self.area.bounds).reshape(2, 2))
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def without(self, file: str) -> "Place":
        """The place without the no-go zones in a file of polygons, or the data of a raster.

        Raises:
            ValueError: The file cannot be read, has another system, or nothing of the area is left.
        """
        zones = self._read_shape(file)
        shape = to_shape(self.area)
        left = shapely.difference(shape, zones)
        if left.area <= 1e-9 * shape.area:
            raise ValueError(f"{file}: its no-go zones leave nothing of the area")
        reduced = replace(self, area=to_area(left))
        is_apart = left.area >= (1.0 - 1e-12) * shape.area
        return reduced.noted(f"{file}: no part of it is in the area.") if is_apart else reduced

    def region(self, file: str) -> Area:
        """The part of the place inside the polygons in a file, or where a raster has data.

        Raises:
            ValueError: The file cannot be read, has another system, or no part of it is in the area.
        """
        shape = to_shape(self.area)
        inside = shapely.intersection(shape, self._read_shape(file))
        if inside.area <= 1e-9 * shape.area:
            raise ValueError(f"{file}: no part of it is in the area")
        return to_area(inside)

    def _read_shape(self, file: str) -> BaseGeometry:
        """The polygons in a file, or the cells with data of a raster, in the frame of the place."""
        with in_file(file):
            shape, crs, _ = _read(file)
            return shapely.transform(shape, lambda points: self.projection.from_other(points, crs))


def read_place(area: str, below: float | None = None, frame: Projection | None = None) -> Place:
    """The area that a text names: a file of polygons or of a raster, or a size such as `500x300`, in metres.

    Of a raster, only cells with values below `below` belong to it. It is placed in `frame`, or in its own.
    """
    if size := _SIZE.fullmatch(area):
        if below is not None:
            raise ValueError(f"{area}: has no values; allowed with --below: a raster")
        width, height = (_metres(size[i], size[i + 1] or size[4] or "m", area) for i in (1, 3))
        projection = Projection.of(None, (0, 0, width, height), area)
        return Place(area, Area.rectangle(0.0, 0.0, width, height), projection)
    suffix = Path(split_choice(area)[0]).suffix.lower()
    if suffix not in (*polygons.SUFFIXES, *RASTERS):
        allowed = f"a size such as 500x300, or a file: {', '.join((*polygons.SUFFIXES, *RASTERS))}"
        shapes = {".shp", ".gpkg"}  # formats that GIS programs write by default
        hint = f" (ogr2ogr area.geojson {area} converts it)" if suffix in shapes else ""
        raise ValueError(f"area: got {area}; allowed: {allowed}{hint}")
    with in_file(area):
        shape, crs, raster = _read(area, below)
        notes = [] if raster is None else [f"{area}: {note}" for note in raster.notes]
        if raster is not None and raster.step > 1:
            notes.append(f"{area}: only every {raster.step}th row and column is used.")
        projection = frame or Projection.of(crs, shape.bounds, area)
        local = shapely.transform(shape, lambda points: projection.from_other(points, crs))
        values = None if raster is None else values_of(area, raster, raster.crs, projection)
    if projection.distortion > TOLERANCE:
        notes.append(
            f"{area}: is so large that distances are off by up to {100 * projection.distortion:.0f}% at its "
            "ends."
        )
    return Place(area, to_area(local), projection, tuple(notes), values)


def values_of(file: str, read: Raster | Points, crs: str | None, projection: Projection) -> Values:
    """The values read from a file with this `crs`, in the frame of a projection; few enough to be drawn."""
    points, values = read.thinned(MOST_DRAWN).cells
    return Values(file, projection.from_other(points, crs), values, read.label)


@lru_cache(maxsize=8)
def read_outlined(
    file: str, avoid: tuple[str, ...], below: float | None, frame: str | None, sha256: str | None
) -> Place:
    """The area in a file without no-go zones, in the frame of a file of a field or of polygons, or its own.

    It is kept, since settings are read several times before anything runs; with other `sha256` of its files
    it is read again.
    """
    if _SIZE.fullmatch(file):
        raise ValueError(f"file: got {file}; allowed: a file of polygons, or a raster")
    is_of_polygons = frame is not None and Path(frame).suffix.lower() in polygons.SUFFIXES
    of_frame = None if frame is None else read_place(frame).projection if is_of_polygons else frame_of(frame)
    place = read_place(file, below, of_frame)
    for zones in avoid:
        place = place.without(zones)
    return place


def _metres(text: str, unit: str, name: str) -> float:
    try:
        value = float(text) * (1000.0 if unit == "km" else 1.0)
    except ValueError:
        value = math.nan
    if not (0 < value < 1e9):
        raise ValueError(f"area: got {name}; allowed: two lengths above 0, such as 500x300 or 2kmx1.5km")
    return value


def _read(file: str, below: float | None = None) -> tuple[BaseGeometry, str | None, Raster | None]:
    """The polygons in a file, or the cells with data of a raster, their system, and that raster."""
    if Path(file).suffix.lower() in polygons.SUFFIXES:
        if below is not None:
            raise ValueError("has no values; allowed with --below: a raster")
        return *polygons.read_polygons(file), None
    raster = read_raster(file, MOST_CELLS)
    inside = ~raster.is_hole
    if below is not None:
        inside &= np.nan_to_num(raster.values, nan=np.inf) < below
        if not inside.any():
            low, high = np.nanmin(raster.values), np.nanmax(raster.values)
            raise ValueError(f"no cell is below {below:g}: the values are from {low:g} to {high:g}")
    return shape_of_cells(raster.x, raster.y, inside), raster.crs, raster


def shape_of_cells(x: np.ndarray, y: np.ndarray, inside: np.ndarray) -> BaseGeometry:
    """Polygons around the cells `[y, x]` of a grid that are inside, half a cell beyond their centres."""
    from contourpy import FillType, contour_generator

    x_step, y_step = x[1] - x[0], y[1] - y[0]
    x = np.concatenate([[x[0] - x_step], x, [x[-1] + x_step]])
    y = np.concatenate([[y[0] - y_step], y, [y[-1] + y_step]])
    generator = contour_generator(x, y, np.pad(inside, 1).astype(float), fill_type=FillType.OuterOffset)
    found = []
    for points, offsets in zip(*generator.filled(0.5, 2.0), strict=True):
        rings = [points[begin:end] for begin, end in zip(offsets[:-1], offsets[1:], strict=True)]
        found.append(shapely.Polygon(rings[0], rings[1:]))
    shape = shapely.make_valid(shapely.union_all(found))
    return shape.simplify(0.3 * min(x_step, y_step))
