"""The routes and maps of bench_survey.py, run in a process with its own cores.

A sample every 0.2 units along a route, with noise of standard deviation 0.05; one process maps what every
route measures, and all planners know it. Its hyper-parameters and the fields are in `survey_fields.py`. The
starts are stored in `data/survey_peers.json`, and for the empty square the routes of SGP-Tools 2.0.7
(ContinuousSGP) and of a lawnmower from the nearest corner. The other lawnmower is the best of `bojax survey`.
"""

import json
import math
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from bench_survey import parse
from rich.console import Console
from rich.table import Table
from scipy.spatial.distance import cdist
from scipy.stats import t as student
from survey_fields import LENGTHSCALE, NOISE_VARIANCE, SQUARE, VARIANCE, Field, league
from survey_rivals import myopic_route, random_route

from bojax.models.gaussian_process import GaussianProcess
from bojax.surveys.area import Area
from bojax.surveys.information import PointErrors
from bojax.surveys.lawnmower import Ground
from bojax.surveys.model import FieldModel
from bojax.surveys.planning import Demand, plan_survey
from bojax.surveys.polylines import length_of, points_along
from bojax.surveys.route import spread_points
from bojax.surveys.shapes import to_area

SPACING, NOISE, GRID = 0.2, 0.05, 0.25
PEERS = Path(__file__).parent / "data" / "survey_peers.json"
METHODS = ("bojax", "lawnmower", "from a corner", "SGP-Tools", "myopic", "random")
STORED = {"from a corner": "lawnmower", "SGP-Tools": "sgptools"}
MODEL = FieldModel(LENGTHSCALE, VARIANCE**0.5, NOISE_VARIANCE**0.5, "the league's")

Routes = dict[str, list[np.ndarray]]


def main(argv: list[str]) -> int:
    """Plan the routes, map the fields, and print the errors."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    stored = json.loads(PEERS.read_text())
    starts = np.asarray(stored["starts"])[: args.starts, :2]
    fields, shares = league(), []
    for budget in args.budgets:
        planned: dict[int, Routes] = {}
        table, against = _tables(budget, len(starts))
        for field in fields:
            if id(field.area) not in planned:
                planned[id(field.area)] = _routes(field.area, budget, starts)
                if field.area is SQUARE:
                    for name, key in STORED.items():
                        paths = stored[f"{key}-{budget}"][: args.starts]
                        planned[id(SQUARE)][name] = [np.asarray(path) for path in paths]
            scores = _scores(field, planned[id(field.area)], budget)
            shares.append(_report(field, scores, table, against))
        Console(width=140).print(table, against)
    print(
        "RMSE of bojax relative to the other's, mean over fields and lengths, with 95% intervals over starts"
    )
    for name in METHODS[1:]:
        known = np.array([share[name] for share in shares if name in share])
        print(f"{name} ({len(known)} cells): {_interval(known.mean(axis=0))}")
    return 0


def _tables(budget: int, number: int) -> tuple[Table, Table]:
    table = Table(title=f"Length {budget}: RMSE, and mean deviation, over {number} starts")
    against = Table(title=f"Length {budget}: RMSE of bojax minus the other's, paired, with 95% intervals")
    for each, names in ((table, METHODS), (against, METHODS[1:])):
        each.add_column("field")
        for name in names:
            each.add_column(name, justify="right")
    return table, against


def _routes(area: Area, budget: int, starts: np.ndarray) -> Routes:
    """Routes of each method, from the points of the area nearest to the starts."""
    part = to_area(Ground.of(area).shape)
    points, model = part.grid(GRID), MODEL.belief()
    errors = PointErrors.of(model, jnp.asarray(spread_points(part, 400)))
    routes: Routes = {name: [] for name in METHODS if name not in STORED}
    seconds = []
    for index, start in enumerate(starts):
        start = start if part.contains(start[None])[0] else points[cdist([start], points).argmin()]
        begin = time.process_time()
        survey = plan_survey(part, MODEL, Demand(float(budget), start, sampling=SPACING))
        seconds.append(time.process_time() - begin)
        routes["bojax"].append(survey.chosen.routes[0])
        routes["lawnmower"].append(survey.lawnmower.routes[0])
        routes["random"].append(random_route(part, budget, start, index))
        routes["myopic"].append(myopic_route(part, errors, budget, start, SPACING))
    print(f"length {budget}: {np.median(seconds):.1f} CPU s a survey", file=sys.stderr)
    return routes


def _scores(field: Field, routes: Routes, budget: int) -> dict[str, np.ndarray]:
    """RMSE and mean deviation `[starts, 2]` of the map of each route."""
    grid = to_area(Ground.of(field.area).shape).grid(GRID)
    truth, kernel = field.value(grid), MODEL.belief().kernel

    @jax.jit
    def mapped(x, y, count):
        return GaussianProcess.fit(kernel, NOISE_VARIANCE, x, y, count=count).predict(jnp.asarray(grid))

    def score(route: np.ndarray, seed: int) -> tuple[float, float]:
        distances = SPACING * np.arange(1, round(budget / SPACING) + 1)
        points = points_along(route, distances)
        noise = NOISE * np.random.default_rng(seed).standard_normal(len(points))
        count = np.sum(distances <= length_of(route) * (1.0 + 1e-9))
        mean, variance = mapped(points, field.value(points) + noise, jnp.asarray(count, jnp.int32))
        return math.sqrt(np.mean((truth - np.asarray(mean)) ** 2)), float(
            np.sqrt(np.asarray(variance)).mean()
        )

    return {
        name: np.array([score(route, index) for index, route in enumerate(found)])
        for name, found in routes.items()
    }


def _report(
    field: Field, scores: dict[str, np.ndarray], table: Table, against: Table
) -> dict[str, np.ndarray]:
    """Add the rows of a field, and return the relative RMSE of bojax to each other method, by start."""
    cells = ["{:.3f} {:.3f}".format(*scores[name].mean(axis=0)) if name in scores else "" for name in METHODS]
    table.add_row(field.name, *cells)
    own = scores["bojax"][:, 0]
    others = {name: each[:, 0] for name, each in scores.items() if name != "bojax"}
    differences = [_interval(own - others[name]) if name in others else "" for name in METHODS[1:]]
    against.add_row(field.name, *differences)
    return {name: own / other for name, other in others.items()}


def _interval(values: np.ndarray) -> str:
    """Mean and 95% interval of Student's t."""
    if len(values) < 2:
        return f"{values.mean():+.3f}"
    half = student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values))
    return f"{values.mean():+.3f} ({values.mean() - half:+.3f}, {values.mean() + half:+.3f})"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
