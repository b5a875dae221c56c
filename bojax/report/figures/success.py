"""Share of runs that have succeeded by each step, with Wilson bands."""

import numpy as np

from bojax.report import statistics
from bojax.report.figures.base import Drawing, Undrawable, drawn_points
from bojax.report.figures.curves import draw_curves
from bojax.report.source import Results
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
    curves = {}
    for point in points:
        rows = results.runs_of(point)
        when = rows["steps"][np.asarray(rows["success"], dtype=bool)]
        hits = (when[:, None] <= np.arange(last + 1)).sum(axis=0)
        low, high = statistics.wilson(hits, rows["run"].size)
        high[0] = 0.0  # nothing can have succeeded before the first step: that is no estimate
        curves[point.index] = (hits / rows["run"].size, low, high)
    ends = ", ".join(f"{point.name} {percent(float(curves[point.index][0][-1]))}" for point in points)
    return Drawing(
        figure=draw_curves(points, curves, "runs that have succeeded (%)", is_share=True),
        title="Success by step",
        caption=f"Share of runs that have succeeded by each step, with pointwise 95% Wilson bands.{note}",
        alt=f"Line chart of the share of successful runs by step. At the last step: {ends}.",
    )
