"""Files of a route: CSV, GeoJSON, GPX, and the plan format of QGroundControl."""

import json
from pathlib import Path

import numpy as np

from bojax.fields.projection import Projection
from bojax.results.store import write_content
from bojax.surveys.polylines import driven_at

_BOAT, _ARDUPILOT, _WAYPOINT, _RELATIVE_ALTITUDE = 11, 3, 16, 3  # of MAVLink


def write_waypoints(
    folder: Path, waypoints: np.ndarray, projection: Projection, speed: float | None, stem: str = "waypoints"
) -> list[Path]:
    """Write a route `[W, 2]` in metres to files of a folder with a stem, and return their paths.

    The CSV file has x and y in metres, the coordinates of the area's file if they differ, longitude and
    latitude if the area has a place on the Earth, and the distance from the start. The GeoJSON file holds
    a line, whose longitudes go on beyond 180 across the date line; without a place on the Earth, its
    coordinates are metres. The plan and the GPX file need such a place.
    """
    degrees = None if projection.crs is None else projection.to_degrees(waypoints)
    columns = {"x": waypoints[:, 0], "y": waypoints[:, 1]}
    if degrees is not None:
        columns |= {"longitude": degrees[:, 0], "latitude": degrees[:, 1]}
    columns["distance"] = driven_at(waypoints)
    formats = [".8f" if name in ("longitude", "latitude") else ".3f" for name in columns]
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(format(value, each) for value, each in zip(row, formats, strict=True)) for row in rows]
    files = {f"{stem}.csv": "\n".join([",".join(columns), *lines, ""])}
    line = waypoints if degrees is None else _unwrapped(degrees)
    files[f"{stem}.geojson"] = json.dumps(_line(line, degrees is None))
    if degrees is not None:
        files[f"{stem}.plan"] = json.dumps(_plan(degrees, speed), indent=1)
        files[f"{stem}.gpx"] = _gpx(degrees)
    for name, content in files.items():
        write_content(folder / name, content)
    return [folder / name for name in files]


def _unwrapped(degrees: np.ndarray) -> np.ndarray:
    """The same places with longitudes that go on across the date line: a jump goes around the Earth."""
    longitudes = np.unwrap(degrees[:, 0], period=360.0)
    return np.column_stack([longitudes + 360.0 * (longitudes.min() < -180.0), degrees[:, 1]])


def _line(coordinates: np.ndarray, is_local: bool) -> dict:
    geometry = {"type": "LineString", "coordinates": np.round(coordinates, 3 if is_local else 8).tolist()}
    feature = {"type": "Feature", "properties": {"name": "route"}, "geometry": geometry}
    collection = {"type": "FeatureCollection", "features": [feature]}
    return {**collection, "crs": None} if is_local else collection


def _gpx(degrees: np.ndarray) -> str:
    """A route of GPX 1.1, which chart plotters and hand-held receivers read."""
    points = [f'  <rtept lat="{latitude:.8f}" lon="{longitude:.8f}"/>' for longitude, latitude in degrees]
    start = '<?xml version="1.0" encoding="UTF-8"?>'
    opening = '<gpx version="1.1" creator="bojax" xmlns="http://www.topografix.com/GPX/1/1">'
    return "\n".join([start, opening, " <rte>", *points, " </rte>", "</gpx>", ""])


def _plan(degrees: np.ndarray, speed: float | None) -> dict:
    """A plan for a boat with ArduPilot; QGroundControl converts it for another vehicle."""
    items = [
        {
            "type": "SimpleItem",
            "autoContinue": True,
            "command": _WAYPOINT,
            "doJumpId": number,
            "frame": _RELATIVE_ALTITUDE,
            "params": [0, 0, 0, None, round(float(latitude), 8), round(float(longitude), 8), 0],
            "AMSLAltAboveTerrain": None,
            "Altitude": 0,
            "AltitudeMode": 1,
        }
        for number, (longitude, latitude) in enumerate(degrees, start=1)
    ]
    mission = {
        "version": 2,
        "firmwareType": _ARDUPILOT,
        "vehicleType": _BOAT,
        "cruiseSpeed": speed or 1.0,
        "hoverSpeed": speed or 1.0,
        "globalPlanAltitudeMode": 1,
        "plannedHomePosition": [float(degrees[0, 1]), float(degrees[0, 0]), 0],
        "items": items,
    }
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": mission,
    }
