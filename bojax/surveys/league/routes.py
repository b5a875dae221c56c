"""Routes of every method of the league from one start.

The starts are stored in `peers.json`, with the routes of SGP-Tools 2.0.7 that `benchmarks/sgptools_paths.py`
has made.
"""

import json
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.spatial.distance import cdist

from bojax.areas.area import Area
from bojax.areas.shapes import to_area
from bojax.surveys.information import PointErrors
from bojax.surveys.lawnmower import Ground
from bojax.surveys.league.fields import (
    LENGTHSCALE,
    MODEL,
    NOISE_VARIANCE,
    SIDE,
    VARIANCE,
    Field,
)
from bojax.surveys.league.rivals import corner_route, myopic_route, random_route
from bojax.surveys.mission import Mission
from bojax.surveys.planning import Demand, plan_survey
from bojax.surveys.polylines import Waypoints, length_of, points_along
from bojax.surveys.route import fitted, spread_points

SPACING, NOISE = 0.2, 0.05
"""Distance between two measurements, and the standard deviation of their noise."""

GRID = 0.25
"""Spacing of the points at which maps are scored."""

LEG = 5.0
"""Distance that an adaptive route drives before it is planned anew."""

CORNER, STORED = "lawnmower from a corner", "SGP-Tools"
"""The method with routes for the empty square alone, and the one whose routes are stored."""


PEERS = Path(__file__).with_name("peers.json")


@cache
def peers() -> dict[str, Any]:
    """The starts, and the stored routes by method, place and length."""
    return json.loads(PEERS.read_text())


def surveyed(area: Area) -> Area:
    """The part of an area that is surveyed: the largest."""
    return to_area(Ground.of(area).shape)


def start_of(part: Area, index: int) -> Waypoints:
    """A start `[2]`: the stored one, or the nearest point of the area."""
    stored = np.asarray(peers()["starts"][index][:2])
    if part.contains(stored[None])[0]:
        return stored
    points = part.grid(GRID)
    return points[cdist([stored], points).argmin()]


def map_routes(field: Field, length: float, index: int) -> tuple[dict[str, Waypoints], float]:
    """The routes of all methods that do not depend on values, and the CPU seconds of `bojax survey`."""
    part = surveyed(field.area)
    start = start_of(part, index)
    begin = time.process_time()
    survey = plan_survey(part, MODEL, Demand(length, start, sampling=SPACING))
    seconds = time.process_time() - begin
    errors = PointErrors.of(MODEL.belief(), jnp.asarray(spread_points(part, 400)))
    routes = {
        "bojax": survey.chosen.routes[0],
        "lawnmower": survey.lawnmower.routes[0],
        "myopic": myopic_route(part, errors, length, start, SPACING),
        "random": random_route(part, length, start, index),
    }
    if field.place == "square":
        routes[CORNER] = corner_route(SIDE, errors, length, start, SPACING)
    if stored := peers().get(f"sgptools-{field.place}-{length:g}"):
        routes[STORED] = np.asarray(stored[index])
    return routes, seconds


def adaptive_route(
    field: Field,
    length: float,
    index: int,
    goal: str,
    leg_length: float = LEG,
    changed: Callable[[Mission, Waypoints], Waypoints] = lambda mission, plan: plan,
) -> Waypoints:
    """The route of a `Mission` from start `index`, which is planned anew after every leg.

    `changed` changes a plan, from the position on, before it is driven.
    """
    part = surveyed(field.area)
    start = start_of(part, index)
    mission = Mission(part, length, start, spacing=SPACING, goal=goal)
    mission.measured.hyperparameters = LENGTHSCALE, VARIANCE, NOISE_VARIANCE
    noise, route = noises(length, index), start[None]
    while (driven := length_of(route)) < length - 0.5 * SPACING:
        ahead = changed(mission, np.concatenate([route[-1:], mission.plan()]))
        leg = fitted(ahead, min(leg_length, length - driven), None, None)
        if length_of(leg) == 0.0:
            break
        route, taken = np.concatenate([route, leg[1:]]), mission.num_measurements
        reached = int(length_of(route) / SPACING * (1.0 + 1e-9))
        points = points_along(route, SPACING * np.arange(taken + 1, reached + 1))
        mission.observe(points, field.value(points) + noise[taken:reached], route[-1])
    return route


def noises(length: float, index: int) -> np.ndarray:
    """Noise of the measurements along a route, the same for all methods."""
    return NOISE * np.random.default_rng(index).standard_normal(round(length / SPACING))
