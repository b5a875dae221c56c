"""The files of a planned survey."""

from pathlib import Path
from typing import Any

import numpy as np

from bojax import __version__
from bojax.areas.place import Place
from bojax.areas.shapes import rings_of, to_shape
from bojax.results.store import make_folder, write_arrays, write_json
from bojax.surveys.model import FieldModel
from bojax.surveys.planning import Candidate, Demand, Survey
from bojax.surveys.simulated import robot_stem, write_simulation
from bojax.surveys.team import FAN, least_distance
from bojax.surveys.turns import least_radius
from bojax.surveys.waypoints import write_waypoints


def write_survey(
    folder: Path,
    place: Place,
    model: FieldModel,
    survey: Survey,
    demand: Demand,
    speed: float | None,
    command: str,
) -> list[Path]:
    """Write the waypoints of the proposed route, a simulation of it, and what a page needs.

    The paths of all but the last are returned.

    `survey.json` holds the candidates, the model and the settings; `survey.npz` the map: `grid [M, 2]`, the
    standard deviations `before [M]` and `after [M]`, the `weights [M]` of the goal, the border,
    `outline [P, 2]` with `ring_ends`, and what was read from each file, `read_0 [N, 3]` and so on.
    """
    make_folder(folder)
    files = []
    for robot, route in enumerate(survey.chosen.routes):
        stem = robot_stem("waypoints", robot, demand.robots)
        files += write_waypoints(folder, route, place.projection, speed, stem)
    rings = rings_of(to_shape(place.area))
    arrays = {
        "grid": survey.grid,
        "weights": survey.weights,
        "before": survey.before,
        "after": survey.after,
        "outline": np.concatenate(rings),
        "ring_ends": np.cumsum([len(ring) for ring in rings]),
    }
    read = [each for each in (place.values, model.read) if each is not None]
    if len(read) == 2 and read[0].file == read[1].file:
        del read[0]
    arrays |= {f"read_{i}": np.column_stack([each.points, each.values]) for i, each in enumerate(read)}
    write_arrays(folder / "survey.npz", arrays)
    content = {
        "area": place.name,
        "read": [{"file": each.file, "label": each.label} for each in read],
        "rule": (
            "Best is the least error."
            if demand.budget is not None or demand.turning_radius
            else "All cover the area: best is the shortest."
        )
        + (
            " Last are those that come closer than the separation."
            if demand.separation and demand.robots > 1
            else ""
        ),
        "goal": {"kind": demand.goal.kind, "meaning": demand.goal.meaning},
        "grid_spacing": survey.grid_spacing,
        "settings": _settings(place, model, survey, demand, speed),
        "candidates": [_plain(each) for each in survey.candidates],
        "projection": {
            "crs": place.projection.crs,
            "origin": list(place.projection.origin),
            "scale": list(place.projection.scale),
        },
        "provenance": {"command": command, "bojax": __version__},
    }
    write_json(folder / "survey.json", content)
    return files + write_simulation(folder, place, model, survey, demand)


def _settings(
    place: Place, model: FieldModel, survey: Survey, demand: Demand, speed: float | None
) -> dict[str, str]:
    chosen, budget = survey.chosen, demand.budget
    rows = {
        "area": f"{place.size / 1e6:.4g} km\N{SUPERSCRIPT TWO}"
        if place.size > 1e5
        else f"{place.size:.4g} m\N{SUPERSCRIPT TWO}",
        "model": f"Matern 5/2; {model.source}",
        "lengthscale": f"{model.lengthscale:.4g} m",
        "standard deviation of the field": f"{model.std:.4g}",
        "standard deviation of the noise": f"{model.noise:.4g}",
        "distance between measurements": f"{survey.sampling:.4g} m",
        "goal": f"least mean standard deviation {demand.goal.meaning}",
        "budget": "none: the area is covered" if budget is None else f"{budget:.6g} m",
    }
    if demand.robots > 1:
        apart = least_distance(chosen.routes, demand.separation)
        rows["robots"] = f"{demand.robots}, each with the budget"
        rows["least distance of two robots"] = f"{apart:.4g} m at equal times" + (
            f", but for {FAN * demand.separation:g} m from a common start or to a common end"
            if demand.separation
            else ""
        )
    if survey.lines is not None:
        rows["distance between lines"] = f"{survey.lines:.4g} m"
    if demand.turning_radius:
        least = min(map(least_radius, chosen.routes))
        tightest = f"the tightest turn has {least:.4g} m" if least < chosen.length else "there is no turn"
        rows["turning radius"] = f"{demand.turning_radius:g} m; {tightest}"
        if survey.lines is not None:
            missed = 100.0 * survey.missed
            rows["left out for the turns"] = (
                f"{missed:.2g}% of the area is farther from the route than the distance between two lines"
            )
    if speed is not None:
        rows["duration"] = f"{chosen.length / speed / 60:.1f} min at {speed:g} m/s"
    for number, note in enumerate(place.notes, start=1):
        rows[f"note {number}"] = note
    return rows


def _plain(candidate: Candidate) -> dict[str, Any]:
    return {
        "name": candidate.name,
        "method": candidate.method,
        "detail": candidate.detail,
        "length": candidate.length,
        "distances": candidate.distances.tolist(),
        "errors": candidate.errors.tolist(),
        "routes": [route.tolist() for route in candidate.routes],
    }
