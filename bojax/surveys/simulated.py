"""A config of `bojax run` that simulates a survey: planners drive on a field that the model expects."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from bojax.areas.area import longer_side
from bojax.areas.place import Place
from bojax.areas.settings import OutlinedArea
from bojax.config.yaml_file import dump
from bojax.results.store import write_content
from bojax.surveys.lawnmower import Ground
from bojax.surveys.model import FieldModel
from bojax.surveys.planning import Demand, Survey
from bojax.surveys.polylines import length_of

FIELD, AREA = "field.csv", "area.geojson"
"""The field, and the area in its metres."""

RESOLUTION = OutlinedArea.model_fields["resolution"].default

CELLS = 40
"""Cells of the longer side of the field."""

PATH_SAMPLES = 5
"""Measurements along a path of one lengthscale, the action of a planner."""

_COMMENT = """\
# bojax run simulates this survey: the same area, budget and ends. Lengths are in metres, so that another
# planner needs its settings as well; {planners} beside this file has those of several.
"""

_ALONE = """\
# A run has one robot: what the others of this survey measure does not count in it.
"""

ROUNDING = 1e-6
"""Room beyond the domain, as a share of its longer side: a drive to an end on the border is rounded."""

ROOM = 1.5
"""Paths for which there is room, relative to those that use the budget: walls and borders shorten some."""


def write_simulation(
    folder: Path, place: Place, model: FieldModel, survey: Survey, demand: Demand
) -> list[Path]:
    """Write a config and a sweep for each robot, and their files; return the paths of configs and sweeps.

    Without an earlier survey, the field is one that the model draws; with one, it is what the earlier survey
    makes the model expect. A run has one robot, which does not know what others measure.
    """
    rows = [",".join(f"{value:.6g}" for value in row) for row in _values(model, place.area.bounds)]
    write_content(folder / FIELD, "\n".join(rows) + "\n")
    write_content(folder / AREA, _geojson(Ground.of(place.area, survey.chosen.routes[0][0]).rings))
    return [
        file
        for robot in range(demand.robots)
        for file in _write_robot(folder, place, model, survey, demand, robot)
    ]


def robot_stem(name: str, robot: int, robots: int) -> str:
    """The name of a file of a robot without its ending: with the robot's number if there are several."""
    return name if robots == 1 else f"{name}-{robot + 1}"


def _write_robot(
    folder: Path, place: Place, model: FieldModel, survey: Survey, demand: Demand, robot: int
) -> list[Path]:
    """Write the best lawnmower of a robot, a config of its survey and a sweep over planners on it."""
    bounds, route, end = place.area.bounds, survey.chosen.routes[robot], demand.ends[robot]
    mower, config, sweep_file, waypoints = (
        folder / f"{robot_stem(name, robot, demand.robots)}{ending}"
        for name, ending in (
            ("lawnmower", ".csv"), ("simulation", ".yaml"), ("planners", ".yaml"), ("waypoints", ".csv")
        )
    )  # fmt: skip
    lines = [f"{x:.3f},{y:.3f}" for x, y in survey.lawnmower.routes[robot]]
    write_content(mower, "\n".join(["x,y", *lines, ""]))
    length = demand.budget or length_of(route)
    path = min(model.lengthscale, length / 2.0)
    first = next((each for each in route[1:] - route[0] if np.any(each != 0.0)), np.ones(2))
    heading = math.atan2(first[1], first[0])
    origin = "what the earlier survey expects" if model.seen is not None else "a draw from the model"
    of = f" by robot {robot + 1} of {demand.robots} alone" if demand.robots > 1 else ""
    title = f"Simulated survey of {Path(place.name).name}{of}, on {origin}"
    # A config names files from wherever it is run: by their whole paths.
    planners = _planners(waypoints.resolve(), mower.resolve(), path, model.std)
    loss = -PATH_SAMPLES * model.std
    content: dict[str, Any] = {
        "title": title,
        "problem": {
            "kind": "monitoring",
            "field": {"kind": "grid", "file": str(folder.resolve() / FIELD), "extent": list(bounds)},
            "domain": list(bounds),
            "margin": ROUNDING * longer_side(bounds),
            "area": {
                "kind": "outline",
                "file": str(folder.resolve() / AREA),
                "checks": _checks(bounds, path),
            },
            "start": [*route[0].tolist(), heading],
            **({} if end is None else {"end": end.tolist()}),
            "objective": "uncertainty",
            "mean": {"kind": "constant", "value": model.mean},
            "kernel": {
                "kind": "scaled",
                "kernel": {"kind": "matern52", "lengthscale": model.lengthscale},
                "variance": model.std**2,
            },
            "noise": model.noise,
            "noise_variance": model.noise**2,
            "collision_reward": loss,
            "exit_reward": loss,
            "budget": length,
            "max_steps": math.ceil(ROOM * length / path),
            "errors_by_step": True,
        },
        "planner": planners["sbo" if demand.robots == 1 else "route"],
        "runs": 8,
    }
    comment = _COMMENT.format(planners=sweep_file.name) + (_ALONE if demand.robots > 1 else "")
    write_content(config, comment + dump(content))
    sweep = {"title": title, "base": config.name, "axes": {"planner": planners}, "runs": 8}
    write_content(sweep_file, "# bojax sweep compares planners on this survey.\n" + dump(sweep))
    return [config, sweep_file]


def _planners(waypoints: Path, mower: Path, path: float, std: float) -> dict[str, dict[str, Any]]:
    """Settings of planners whose paths have a length, in metres, on a field with a standard deviation."""
    pieces = {"length": path, "num_samples": PATH_SAMPLES}
    search = {"iterations": 100, "exploration": 10.0 * std}

    def motions(kind: str, **more: int) -> dict[str, Any]:
        return {"motions": {"kind": kind, **more, **pieces}}

    return {
        "route": {"kind": "route", "file": str(waypoints), **pieces},
        "lawnmower": {"kind": "route", "file": str(mower), **pieces},
        "kcbts": {"kind": "kcbts", **search, **motions("kernel")},
        "cbts": {"kind": "cbts", **search, **motions("cubic")},
        "sbo": {"kind": "sbo", **search, **motions("splines", actions=9)},
        "myopic": {"kind": "myopic", **motions("splines", actions=9)},
        "random": {"kind": "random", **motions("splines", actions=9)},
    }


def _checks(bounds: tuple[float, float, float, float], path: float) -> int:
    """Checks between two poses that are as many as the table of distances has cells there."""
    return max(2, math.ceil(path / PATH_SAMPLES / (longer_side(bounds) / RESOLUTION)))


def _geojson(rings: list[np.ndarray]) -> str:
    """One polygon, its border first, in metres."""
    coordinates = [np.round(ring, 4).tolist() for ring in rings]
    return json.dumps({"type": "Polygon", "coordinates": coordinates, "crs": None})


def _values(model: FieldModel, bounds: tuple[float, float, float, float]) -> np.ndarray:
    """Values `[rows, columns]` on a grid over the bounds, the first row at the lowest y."""
    x_min, y_min, x_max, y_max = bounds
    spacing = longer_side(bounds) / CELLS
    x, y = (
        np.linspace(low, high, max(2, round((high - low) / spacing) + 1))
        for low, high in ((x_min, x_max), (y_min, y_max))
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    if model.seen is not None:
        values = model.predict(points)[0]
    else:
        scaled = np.sqrt(5.0) * cdist(points, points) / model.lengthscale
        covariance = model.std**2 * (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
        factor = np.linalg.cholesky(covariance + 1e-8 * model.std**2 * np.eye(len(points)))
        values = model.mean + factor @ np.random.default_rng(0).standard_normal(len(points))
    return values.reshape(len(y), len(x))
