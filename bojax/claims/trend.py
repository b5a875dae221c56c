"""Test of a trend: whether a mean rises or falls between two steps or two windows of episodes."""

import numpy as np

from bojax.claims.samples import Measure, enough, episodes_in, finite, interval_of, mean_of, stand_ins
from bojax.claims.settings import Trend
from bojax.config.claims import Window
from bojax.report import statistics
from bojax.report.findings import Comparison, Finding
from bojax.report.source import Point, Results


def trend(results: Results, test: Trend) -> Finding:
    """Whether a mean falls, or rises, between two steps or between two windows of episodes.

    Between steps, a run that has ended keeps its last value, as in the figures, or is left out.
    """
    (point,), chosen = stand_ins(results, test, Measure(test.column, test.last))
    if test.ended == "left-out":
        interval, runs = _change_of_active(results, test, point)
        method = interval_of(runs)
        between = f"from {_place(test.first)} to the steps after it up to {test.last}"
        within = "of the active runs"
    else:
        measure = Measure(test.column, test.last, since=test.first)
        interval, runs, method = mean_of(results, test, point, measure)
        between, within = f"from {_place(test.first)} to {_place(test.last)}", "within a run"
    return Finding.between(
        *((0.0, None) if test.direction == "rises" else (None, 0.0)),
        [Comparison(f"change of {test.label} {between}", interval)],
        runs=runs,
        method=f"mean change of {test.column} {between} {within}, 95% interval "
        f"against 0 (the claim: it {test.direction}); {method}",
        chosen=chosen,
    )


def _change_of_active(results: Results, test: Trend, point: Point) -> tuple[statistics.Interval, int]:
    """Change from the mean at the first step to that of the later ones, over runs that have not ended."""
    rows, runs = results.steps_of(point), results.runs_of(point)["run"]
    values, step = rows[test.column], rows["step"]
    row = np.searchsorted(runs, rows["run"])
    sums = []
    for is_counted in (step == test.first, (test.first < step) & (step <= test.last)):
        finite(values[is_counted], point.name, test.column)
        enough(len(np.unique(row[is_counted])), "active run")
        sums += [np.bincount(row[is_counted], weights, runs.size) for weights in (values[is_counted], None)]
    table = np.stack(sums, axis=1)  # of each run: value and number at the first step, sum and number after it

    def change(means: statistics.Floats) -> statistics.Floats:
        return means[..., 2] / means[..., 3] - means[..., 0] / means[..., 1]

    return statistics.interval_of_means(change, table), runs.size


def _place(place: int | Window) -> str:
    return f"step {place}" if isinstance(place, int) else episodes_in(place)
