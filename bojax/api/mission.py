"""Surveys that go on: `Mission`, and the `Area` that it surveys, or the `Place` of a file."""

import os

from bojax.areas import place
from bojax.areas.area import Area as Area
from bojax.areas.place import Place as Place
from bojax.surveys.mission import Mission as Mission


def read_place(file: str | os.PathLike[str], below: float | None = None) -> Place:
    """The area in a file of polygons or of a raster, in metres, and where it lies on the Earth.

    `place.area` is for a mission, `place.point(given, name)` moves a point from the coordinates of the file
    to metres, `place.projection.from_local(points)` moves points back, and `place.without(file)` leaves out
    no-go zones.

    Args:
        file: Name of the file, or a size such as `500x300`, in metres.
        below: Of a raster, only cells with values below this number belong to the area.

    Raises:
        ValueError: The file cannot be read, or has no area. The message is one line.
    """
    return place.read_place(os.fspath(file), below)
