"""Share of runs that have succeeded so far, with Wilson bands."""

from collections.abc import Callable, Sequence

import numpy as np

from bojax.report import statistics
from bojax.report.columns import Columns
from bojax.report.drawing.curves import Band
from bojax.report.source import Point, Results
from bojax.report.text import percent


def success_curves(
    results: Results, points: Sequence[Point], last: int, when: Callable[[Columns], np.ndarray]
) -> dict[int, Band]:
    """Share of the runs of each point that have succeeded by each number, with its band."""
    curves = {}
    for point in points:
        rows = results.runs_of(point)
        hits = np.searchsorted(np.sort(when(rows)), np.arange(last + 1), side="right")
        low, high = statistics.wilson(hits, rows["run"].size)
        high[0] = 0.0  # nothing can have succeeded before the first step: that is no estimate
        curves[point.index] = (hits / rows["run"].size, low, high)
    return curves


def ends(points: Sequence[Point], curves: dict[int, Band]) -> str:
    """The last share of each point, for the alternative text."""
    return ", ".join(f"{point.name} {percent(float(curves[point.index][0][-1]))}" for point in points)
