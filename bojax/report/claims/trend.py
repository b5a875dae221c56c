"""Test of a trend: whether a mean rises or falls between two steps or two windows of episodes."""

import dataclasses

import numpy as np

from bojax.config.claims import Window
from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding, bootstrap
from bojax.report.claims.samples import Measure, episodes_in, paired, stand_ins
from bojax.report.claims.settings import Trend
from bojax.report.source import Results


def trend(results: Results, test: Trend) -> Finding:
    """Whether a mean falls, or rises, between two steps or between two windows of episodes.

    Between steps, a run that has ended keeps its last value, as in the figures.
    """
    first, last = (Measure(test.column, place) for place in (test.first, test.last))
    points, chosen = stand_ins(results, test, last)
    if isinstance(test.first, Window):
        changes = paired(results, test, points, dataclasses.replace(last, since=test.first))[:, 0]
    else:
        changes = np.subtract(*(paired(results, test, points, end)[:, 0] for end in (last, first)))
    interval = statistics.mean_interval(changes)
    between = f"from {_place(test.first)} to {_place(test.last)}"
    return Finding.between(
        *((0.0, None) if test.direction == "rises" else (None, 0.0)),
        [Comparison(f"change of {test.label} {between}", interval)],
        runs=len(changes),
        method=f"mean change of {test.column} {between} within a run, 95% interval "
        f"against 0 (the claim: it {test.direction}); {bootstrap(len(changes))}",
        chosen=chosen,
    )


def _place(place: int | Window) -> str:
    return f"step {place}" if isinstance(place, int) else episodes_in(place)
