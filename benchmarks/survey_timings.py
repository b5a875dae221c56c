"""The timings of bench_survey.py, run in a process with its own cores."""

import functools
import sys
import time
from collections.abc import Callable

import jax
import numpy as np
from bench_survey import parse
from rich.console import Console
from rich.table import Table

from bojax.areas.area import Area
from bojax.surveys import route
from bojax.surveys.league.cells import LENGTHS
from bojax.surveys.league.fields import MODEL, SQUARE
from bojax.surveys.league.routes import SPACING, start_of
from bojax.surveys.mission import Mission
from bojax.surveys.planning import Demand, plan_survey

EDGES = (10, 100, 1000, 10_000)
"""Edges of outlines."""

PLANS = {
    "lawnmowers": lambda area, length, at: plan_survey(
        area, MODEL, Demand(length, at, sampling=SPACING), optimises=False
    ),
    "bojax survey": lambda area, length, at: plan_survey(area, MODEL, Demand(length, at, sampling=SPACING)),
    "Mission.plan, first": lambda area, length, at: Mission(area, length, at, spacing=SPACING).plan(),
}
"""Plans of a route of a length from a start."""


def rough(number: int) -> Area:
    """A lake with a number of edges around the middle of the square.

    Its radius has the spectrum of a coast of fractal dimension 1.25, up to the waves that the edges resolve.
    """
    random = np.random.default_rng(0)
    angles = 2.0 * np.pi * np.arange(number) / number
    radius = np.full(number, 4.0)
    for wave in range(2, 2 + number // 4):
        radius += 0.6 * wave**-1.25 * np.sin(wave * angles + random.uniform(0.0, 2.0 * np.pi))
    return Area((5.0 + radius[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1),))


def main(argv: list[str]) -> int:
    """Time the plans in the empty square of the league, and print a table."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    starts = [start_of(SQUARE, index) for index in range(args.starts + 1)]
    if args.routes:
        _time_many(starts, args.routes)
        return 0
    table = Table(title=f"CPU seconds of a plan, median of {args.starts} starts")
    for heading in ("edges" if args.edges else "length", *PLANS):
        table.add_column(heading, justify="right")
    cells = {f"{length}": (SQUARE, length) for length in LENGTHS}
    if args.edges:
        cells = {f"{number:,}": (rough(number), 40.0) for number in EDGES}
    for name, (area, length) in cells.items():
        at = starts if area is SQUARE else [0.4 * start + 3.0 for start in starts]
        timed = [functools.partial(plan, area, length) for plan in PLANS.values()]
        seconds = [_seconds(at, plan) for plan in timed]
        table.add_row(name, *(f"{each:.2f}" for each in seconds))
    Console().print(table)
    return 0


def _time_many(starts: list[np.ndarray], number: int) -> None:
    """Time routes of the largest length from `number` first guesses, which are the lanes of one program.

    The whole plan includes the first guesses and the choice of the best route, which are made on the host.
    """
    inner: list[float] = []
    descend = route.descend

    def timed(*args):
        begin = time.perf_counter()
        found = jax.block_until_ready(descend(*args))
        inner.append(time.perf_counter() - begin)
        assert len(np.unique(np.asarray(found).reshape(number, -1), axis=0)) == number
        return found

    route.descend = timed
    options, length, whole, errors = route.RouteOptions(restarts=number), max(LENGTHS), [], []
    for start in starts:
        begin = time.perf_counter()
        given = {"spacing": SPACING, "options": options}
        (plan,) = route.plan_routes(MODEL.belief(), SQUARE, length, [start], [None], **given)
        whole.append(time.perf_counter() - begin)
        errors.append(plan.error)
    table = Table(
        title=f"{number} routes of length {length:g} at once on {jax.devices()[0].device_kind}, seconds"
    )
    for heading in ("", "compilation and first", "median of the others"):
        table.add_column(heading, justify="right")
    for name, seconds in (("optimisation", inner), ("whole plan", whole)):
        table.add_row(name, f"{seconds[0]:.2f}", f"{np.median(seconds[1:]):.2f}")
    Console().print(table)
    print("expected errors of the best routes:", ", ".join(f"{error:.4f}" for error in errors))


def _seconds(starts: list[np.ndarray], plan: Callable[[np.ndarray], object]) -> float:
    """Median of the CPU seconds of a plan; the first start compiles."""
    seconds = []
    for start in starts:
        begin = time.process_time()
        plan(start)
        seconds.append(time.process_time() - begin)
    return float(np.median(seconds[1:]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
