"""Share of runs that have succeeded by each step, or by each episode, with Wilson bands."""

from collections.abc import Callable, Sequence

import numpy as np

from bojax.report import statistics
from bojax.report.columns import Columns
from bojax.report.figures.base import Drawing, Undrawable, drawn_points
from bojax.report.figures.curves import Band, draw_curves
from bojax.report.source import Point, Results
from bojax.report.text import percent


def draw(results: Results) -> Drawing:
    """Success by step: a run succeeds at its last step or never."""
    runs = results.runs
    if "success" not in runs or "steps" not in runs or not runs["steps"].size:
        raise Undrawable("runs.parquet has no success and steps")
    points, note = drawn_points(results)
    if not all(point.has_success and point.ends_at_success for point in points):
        raise Undrawable("a run of this problem does not end at success, so that steps do not tell when")
    last = int(max(results.num_steps, runs["steps"].max()))
    curves = _curves(results, points, last, lambda table: table["steps"][table["success"].astype(bool)])
    return Drawing(
        figure=draw_curves(points, curves, "runs that have succeeded (%)", is_share=True),
        title="Success by step",
        caption=f"Share of runs that have succeeded by each step, with pointwise 95% Wilson bands.{note}",
        alt=f"Line chart of the share of successful runs by step. At the last step: {_ends(points, curves)}.",
    )


def draw_episodes(results: Results) -> Drawing:
    """Success by episode: the first training episode of a learner that reached the goal (Table 5.3)."""
    if "episodes_to_goal" not in results.runs or not results.num_episodes:
        raise Undrawable("runs.parquet has no episodes_to_goal")
    points, note = drawn_points(results)
    latest = max(_first_successes(results.runs_of(point)).max(initial=1) for point in points)
    last = min(results.num_episodes, max(10, int(1.2 * latest)))
    curves = _curves(results, points, last, _first_successes)
    if last < results.num_episodes:
        note = f" Nothing changes from episode {int(latest)} to the last, {results.num_episodes}.{note}"
    return Drawing(
        figure=draw_curves(
            points, curves, "runs that have reached the goal (%)", xlabel="episode", is_share=True
        ),
        title="Success by episode",
        caption="Share of runs that have reached the goal in one of the training episodes so far, with "
        f"pointwise 95% Wilson bands.{note}",
        alt="Line chart of the share of runs that have reached the goal by training episode. At the end: "
        f"{_ends(points, curves)}.",
    )


def _first_successes(table: Columns) -> np.ndarray:
    when = table["episodes_to_goal"].astype(np.float64)
    return when[np.isfinite(when)]


def _curves(
    results: Results, points: Sequence[Point], last: int, when: Callable[[Columns], np.ndarray]
) -> dict[int, Band]:
    curves = {}
    for point in points:
        rows = results.runs_of(point)
        hits = np.searchsorted(np.sort(when(rows)), np.arange(last + 1), side="right")
        low, high = statistics.wilson(hits, rows["run"].size)
        high[0] = 0.0  # nothing can have succeeded before the first step: that is no estimate
        curves[point.index] = (hits / rows["run"].size, low, high)
    return curves


def _ends(points: Sequence[Point], curves: dict[int, Band]) -> str:
    return ", ".join(f"{point.name} {percent(float(curves[point.index][0][-1]))}" for point in points)
