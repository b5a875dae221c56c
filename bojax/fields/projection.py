"""A local frame in metres for coordinates in degrees or in a map projection."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from bojax.config.extras import needed
from bojax.fields.raster import DEGREES

if TYPE_CHECKING:
    import numpy as np

_EQUATORIAL_RADIUS, _SQUARED_ECCENTRICITY = 6_378_137.0, 0.00669437999014  # WGS 84

TOLERANCE = 0.01
"""Error of lengths beyond which an area is too large for the frame, as a share."""


@dataclass(frozen=True)
class Projection:
    """A frame in metres whose axes are those of the coordinates: x to the east and y to the north.

    The map is linear, so a regular grid stays one, and exact in both directions. Lengths are right in the
    middle of the area, and off by up to `distortion` at its corners.
    """

    crs: str | None  # coordinate reference system; None for metres without a place on the Earth
    origin: tuple[float, float]  # coordinates of the origin of the frame
    scale: tuple[float, float]  # metres that one unit of the coordinates stands for, along x and y
    distortion: float = 0.0  # largest error of lengths in the area, as a share
    file: str = field(default="the area", compare=False)  # what it is the frame of, for messages

    @classmethod
    def of(
        cls, crs: str | None, extent: tuple[float, float, float, float], file: str = "the area"
    ) -> "Projection":
        """The frame of an area with this extent `(x_min, y_min, x_max, y_max)` in coordinates of `crs`.

        The origin is the corner of the extent with the lowest coordinates; without a system, it stays.

        Raises:
            ValueError: The extent is not one of degrees, or the system is unknown.
            MissingExtra: A map projection needs the extra `geo`.
        """
        if crs is None:
            return cls(None, (0.0, 0.0), (1.0, 1.0), file=file)
        x_min, y_min, x_max, y_max = extent
        middle = (x_min + x_max) / 2, (y_min + y_max) / 2
        if crs != DEGREES:
            across, along = scale = _scale(crs, middle)
            at_corners = [_scale(crs, (x, y)) for x in (x_min, x_max) for y in (y_min, y_max)]
            distortion = max(max(abs(x / across - 1.0), abs(y / along - 1.0)) for x, y in at_corners)
            return cls(crs, (x_min, y_min), scale, distortion, file)
        if not (-180 <= x_min and x_max <= 360 and -90 < y_min and y_max < 90 and x_max - x_min < 180):
            corners = f"({x_min:g}, {y_min:g}) to ({x_max:g}, {y_max:g})"
            raise ValueError(
                f"got degrees from {corners}; allowed: longitude, then latitude, of a small area (across the "
                "date line, longitudes up to 360)"
            )
        latitude = math.radians(middle[1])
        bent = 1.0 - _SQUARED_ECCENTRICITY * math.sin(latitude) ** 2
        across = _EQUATORIAL_RADIUS / math.sqrt(bent)
        along = across * (1.0 - _SQUARED_ECCENTRICITY) / bent
        degree = math.pi / 180
        narrowing = [math.cos(math.radians(y)) / math.cos(latitude) for y in (y_min, y_max)]
        distortion = max(abs(share - 1.0) for share in narrowing)
        scale = (across * math.cos(latitude) * degree, along * degree)
        return cls(crs, (x_min, y_min), scale, distortion, file)

    def to_local(self, points: "np.ndarray") -> "np.ndarray":
        """Coordinates `[*, 2]` in metres."""
        return (points - self.origin) * self.scale

    def from_local(self, points: "np.ndarray") -> "np.ndarray":
        """Points `[*, 2]` of the frame in coordinates of the system."""
        return points / self.scale + self.origin

    def to_degrees(self, points: "np.ndarray") -> "np.ndarray":
        """Longitudes and latitudes `[N, 2]` of points of the frame; longitudes are from -180 to 180.

        Raises:
            ValueError: The frame has no place on the Earth.
        """
        import numpy as np

        if self.crs is None:
            raise ValueError(
                "the area has no place on the Earth; allowed: an area in degrees or a projection"
            )
        coordinates = self.from_local(points)
        if self.crs != DEGREES:
            return np.stack(_transformer(self.crs, DEGREES).transform(*coordinates.T), axis=1)
        coordinates[:, 0] = (coordinates[:, 0] + 180.0) % 360.0 - 180.0
        return coordinates

    def from_other(self, points: "np.ndarray", crs: str | None) -> "np.ndarray":
        """Coordinates `[N, 2]` of another system in metres of this frame.

        The message of an error goes on after the name of the file of the points.
        """
        import numpy as np

        if crs == self.crs:
            return self.to_local(points)
        if crs is None or self.crs is None:
            has, other = ("no", "one") if crs is None else ("a", "none")
            differs = f"has {has} place on the Earth, and {self.file} has {other}"
            raise ValueError(f"{differs}; allowed: both or neither")
        return self.to_local(np.stack(_transformer(crs, self.crs).transform(*points.T), axis=1))


def _pyproj():
    with needed("pyproj", "geo"):
        import pyproj
    return pyproj


def _transformer(source: str, target: str):
    return _pyproj().Transformer.from_crs(source, target, always_xy=True)


def _scale(crs: str, middle: tuple[float, float]) -> tuple[float, float]:
    """Metres on the ellipsoid of a unit of a map projection along x and y, at a point of it.

    Units may be feet, and those of Web Mercator shrink with the latitude.
    """
    pyproj = _pyproj()
    try:
        system = pyproj.CRS.from_user_input(crs)
        if system.is_geographic:
            raise ValueError(f"got {system.name}; allowed: {DEGREES} or a map projection")
        transformer = _transformer(crs, DEGREES)
        (x, y), step = middle, 50.0
        west, east, south, north = (
            transformer.transform(x + across, y + along, errcheck=True)
            for across, along in ((-step, 0.0), (step, 0.0), (0.0, -step), (0.0, step))
        )
    except RuntimeError as error:
        message = " ".join(str(error).split())[:100]
        raise ValueError(f"coordinate reference system: {message}") from error
    earth = pyproj.Geod(ellps="WGS84")
    return earth.inv(*west, *east)[2] / (2 * step), earth.inv(*south, *north)[2] / (2 * step)
