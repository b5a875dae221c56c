"""The timings of bench_survey.py, run in a process with its own cores."""

import sys
import time
from collections.abc import Callable

import jax
import numpy as np
from bench_survey import parse
from rich.console import Console
from rich.table import Table

from bojax.surveys import route
from bojax.surveys.league.cells import LENGTHS
from bojax.surveys.league.fields import MODEL, SQUARE
from bojax.surveys.league.routes import SPACING, start_of
from bojax.surveys.mission import Mission
from bojax.surveys.planning import Demand, plan_survey


def main(argv: list[str]) -> int:
    """Time the plans in the empty square of the league, and print a table."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    starts = [start_of(SQUARE, index) for index in range(args.starts + 1)]
    if args.routes:
        _time_many(starts, args.routes)
        return 0
    table = Table(title=f"CPU seconds of a plan, median of {args.starts} starts")
    for heading in ("length", "bojax survey", "Mission.plan, first"):
        table.add_column(heading, justify="right")
    for length in LENGTHS:
        survey = _seconds(
            starts, lambda at, length=length: plan_survey(SQUARE, MODEL, Demand(length, at, sampling=SPACING))
        )
        mission = _seconds(
            starts, lambda at, length=length: Mission(SQUARE, length, at, spacing=SPACING).plan()
        )
        table.add_row(f"{length}", f"{survey:.2f}", f"{mission:.2f}")
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
        plan = route.plan_route(MODEL.belief(), SQUARE, length, start, spacing=SPACING, options=options)
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
