"""Files of missions, from which a process that was killed goes on."""

import dataclasses
import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bojax.areas.area import Area, Ring
from bojax.results.store import write_arrays
from bojax.surveys.goals import Goal
from bojax.surveys.measurements import Measurements
from bojax.surveys.polylines import length_of
from bojax.surveys.route import Robot, Route, RouteOptions
from bojax.surveys.validation import positions

SETTINGS = ("spacing", "relearn_every", "seed", "separation", "_plans")
"""Attributes of a mission that are saved as JSON."""

_OF_MEASUREMENTS = ("hyperparameters", "medians", "shift", "scale", "learned_at", "expected")
"""Attributes of its measurements; except for the first, their names in a file begin with an underscore."""


def write_mission(mission: Mapping[str, Any], path: Path) -> None:
    """Write the attributes of a mission to a file, which is replaced at once or not at all."""
    area, goal, measured, robots = (mission[name] for name in ("area", "goal", "measured", "robots"))
    plain: dict[str, Any] = {name: mission[name] for name in SETTINGS}
    plain |= {_in_file(name): getattr(measured, name) for name in _OF_MEASUREMENTS}
    plain |= {"remaining": [robot.remaining for robot in robots], "_time": [robot.time for robot in robots]}
    plain["counts"], plain["options"] = dict(mission["counts"]), dataclasses.asdict(mission["options"])
    zones, region = _zones(area), _zones(goal.region)
    plain["goal"] = goal.kind, goal.threshold, [len(zone) for zone in region]
    plain["rings"] = [len(zone) for zone in zones]
    rings = [ring for zone in zones + region for ring in zone]
    arrays: dict[str, Any] = {f"ring_{index}": ring for index, ring in enumerate(rings)}
    arrays |= {"x": measured.x, "y": measured.y, "position": [robot.position for robot in robots]}
    nothing = np.zeros((0, 2))
    arrays["end"] = [robot.end for robot in robots if robot.end is not None] or nothing
    arrays |= {
        f"route{number or ''}": nothing if robot.route is None else robot.route.waypoints
        for number, robot in enumerate(robots)
    }
    text = json.dumps(plain, default=np.generic.item)  # users may give numbers of NumPy
    write_arrays(path, {"plain": np.asarray(text), **arrays})


def read_mission(path: str | Path) -> tuple[tuple[Area, list[Robot], RouteOptions], dict[str, Any]]:
    """The mission that a file holds: the arguments of `Mission._prepare`, and attributes by name.

    Files of earlier versions lack some of `SETTINGS`.

    Raises:
        ValueError: The file is not one that `write_mission` wrote.
        FileNotFoundError: There is no such file.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            data = {name: file[name] for name in file.files}
        plain = json.loads(str(data["plain"]))
        options = plain["options"]
        options["stretch"] = tuple(options["stretch"])
        kind, threshold, of_region = plain.get("goal", ("map", np.nan, 0))
        # Files of earlier versions have the number of rings of the region, which lacks its no-go zones there.
        of_region = of_region if isinstance(of_region, list) else [of_region][: of_region > 0]
        sizes = plain["rings"] + of_region
        rings = iter([data[f"ring_{index}"] for index in range(sum(sizes))])
        zones = [tuple(next(rings) for _ in range(size)) for size in sizes]
        number = len(plain["rings"])
        area = Area(zones[0], tuple(zones[1:number]))
        region = Area(zones[number], tuple(zones[number + 1 :])) if of_region else None
        remaining, times = (np.atleast_1d(plain[name]).tolist() for name in ("remaining", "_time"))
        places = positions("position", data["position"], len(remaining))
        ends = positions("end", data["end"], len(remaining)) if data["end"].size else [None] * len(remaining)
        robots = [
            Robot(at, left, to, time=time)
            for at, left, to, time in zip(places, remaining, ends, times, strict=True)
        ]
        for number, robot in enumerate(robots):
            waypoints = data[f"route{number or ''}"]
            if len(waypoints):
                robot.route = Route(waypoints, length_of(waypoints), np.nan, "earlier plan", {})
        measured = Measurements(tuple(plain["hyperparameters"]))
        for name in _OF_MEASUREMENTS[1:]:
            if _in_file(name) in plain:
                setattr(measured, name, plain[_in_file(name)])
        measured.medians = tuple(plain["_medians"])
        measured.restore(data["x"], data["y"])
        attributes = {name: plain[name] for name in SETTINGS if name in plain}
        attributes |= {"goal": Goal(kind, threshold, region), "counts": Counter[str](plain["counts"])}
        return (area, robots, RouteOptions(**options)), {**attributes, "measured": measured}
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{path}: not a saved mission, or damaged") from error


def _zones(area: Area | None) -> list[tuple[Ring, ...]]:
    """The rings of the outline of an area, and of each of its no-go zones."""
    return [] if area is None else [area.outline, *area.avoid]


def _in_file(name: str) -> str:
    return name if name == "hyperparameters" else f"_{name}"
