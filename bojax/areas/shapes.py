"""Areas as geometries of shapely, and back."""

from collections.abc import Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from bojax.areas.area import Area, Ring


def to_shape(area: Area) -> BaseGeometry:
    """The area as one geometry: its outline without its no-go zones."""
    shape = _even_odd(area.outline)
    zones = [_even_odd(zone) for zone in area.avoid]
    return shapely.difference(shape, shapely.union_all(zones)) if zones else shape


def to_area(shape: BaseGeometry) -> Area:
    """A geometry of polygons as an area; points and lines in it are left out."""
    rings = rings_of(shape)
    if not rings:
        raise ValueError("the area is empty")
    return Area(tuple(rings))


def rings_of(shape: BaseGeometry) -> list[Ring]:
    """The borders of the polygons of a geometry, and of their holes."""
    rings = []
    for polygon in polygons_of(shape):
        rings += [np.array(shapely.get_coordinates(ring)) for ring in (polygon.exterior, *polygon.interiors)]
    return rings


def polygons_of(shape: BaseGeometry) -> list:
    """The polygons of a geometry, the largest first."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    found = [part for part in parts if part.geom_type == "Polygon" and part.area > 0.0]
    return sorted(found, key=lambda polygon: -polygon.area)


def _even_odd(rings: Sequence[Ring]) -> BaseGeometry:
    polygons = [shapely.make_valid(shapely.Polygon(ring)) for ring in rings] or [shapely.Polygon()]
    while len(polygons) > 1:  # in pairs, since every difference takes time in proportion to its corners
        pairs = zip(polygons[::2], [*polygons[1::2], shapely.Polygon()], strict=False)
        polygons = [shapely.symmetric_difference(*pair) for pair in pairs]
    return polygons[0]
