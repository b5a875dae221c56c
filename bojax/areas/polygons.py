"""Readers of polygons: GeoJSON and KML."""

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from bojax.config.limits import TEXT, read_within
from bojax.fields.raster import DEGREES
from bojax.text import one_line

SUFFIXES = (".geojson", ".json", ".kml")
"""Endings of the names of files that hold polygons."""


def read_polygons(file: str) -> tuple[BaseGeometry, str | None]:
    """All polygons in a GeoJSON or KML file, and their coordinate reference system; None for metres.

    Other geometries are left out. Coordinates are longitudes and latitudes, as both formats demand. GeoJSON
    may name another system in the member `crs` of the older standard; `"crs": null` means metres without a
    place on the Earth.
    """
    path = Path(file)
    try:
        text = read_within(TEXT, path, file).decode("utf-8-sig")
        is_kml = path.suffix.lower() == ".kml"
        found, crs = _of_kml(text) if is_kml else _of_geojson(json.loads(text))
    except OSError as error:
        raise ValueError(f"{file}: {error.strerror or one_line(error)}") from error
    except json.JSONDecodeError as error:
        raise ValueError(f"{file}: is not JSON: {one_line(error)}") from error
    except (ValueError, TypeError, KeyError, AttributeError, ElementTree.ParseError) as error:
        reason = one_line(error) if isinstance(error, ValueError | ElementTree.ParseError) else "damaged"
        raise ValueError(f"{file}: {reason}") from error
    if not found:
        raise ValueError(f"{file}: holds no polygon")
    return _united(found, file), crs


def _united(found: list[list[Any]], file: str) -> BaseGeometry:
    """The union of polygons, each a list of its border and those of its holes."""
    polygons = []
    for number, rings in enumerate(found, start=1):
        name = f"{file}: polygon {number} of {len(found)}"
        try:
            borders = [np.array([corner[:2] for corner in ring], float) for ring in rings]
            if not all(np.isfinite(border).all() for border in borders):
                raise ValueError("a corner is not finite")
            polygon = shapely.Polygon(borders[0], borders[1:])
        except Exception as error:  # of NumPy, shapely, or an empty list of rings
            raise ValueError(f"{name}: {one_line(error)}") from error
        if not shapely.is_valid(polygon):
            reason = one_line(shapely.is_valid_reason(polygon)).replace("[", " at ").replace("]", "").lower()
            raise ValueError(f"{name}: crosses itself or touches itself ({reason})")
        if polygon.area == 0.0:
            raise ValueError(f"{name}: has no area")
        polygons.append(polygon)
    return shapely.union_all(polygons)


def _of_geojson(content: Any) -> tuple[list[list[Any]], str | None]:
    if not isinstance(content, dict) or "type" not in content:
        raise ValueError("is not GeoJSON")
    crs: str | None = DEGREES
    if "crs" in content:
        crs = None if content["crs"] is None else str(content["crs"]["properties"]["name"])
        if crs is not None and crs.endswith(("CRS84", ":4326")):
            crs = DEGREES
    return _polygons_in(content), crs


def _polygons_in(content: Any) -> list[list[Any]]:
    if not isinstance(content, dict):
        return []
    match content.get("type"):
        case "FeatureCollection":
            return [polygon for each in content["features"] for polygon in _polygons_in(each)]
        case "GeometryCollection":
            return [polygon for each in content["geometries"] for polygon in _polygons_in(each)]
        case "Feature":
            return _polygons_in(content["geometry"])
        case "Polygon":
            return [content["coordinates"]]
        case "MultiPolygon":
            return list(content["coordinates"])
    return []


def _of_kml(text: str) -> tuple[list[list[Any]], str | None]:
    """Polygons of KML. A document type could define entities that expand without end, and is refused."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("has a document type; allowed: KML without one")
    found = []
    for polygon in ElementTree.fromstring(text).iter():
        if _tag(polygon) == "Polygon":
            borders: dict[str, list[Any]] = {"outerBoundaryIs": [], "innerBoundaryIs": []}
            for border in polygon:
                texts = [each.text or "" for each in border.iter() if _tag(each) == "coordinates"]
                borders.get(_tag(border), []).extend(map(_corners, texts))
            found.append(borders["outerBoundaryIs"] + borders["innerBoundaryIs"])
    return found, DEGREES


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _corners(text: str) -> list[list[float]]:
    return [[float(number) for number in corner.split(",")[:2]] for corner in text.split()]
