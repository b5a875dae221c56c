"""Test of a trend: whether a mean rises or falls between two steps or two windows of episodes."""

import numpy as np

from bojax.config.claims import Window
from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding, bootstrap, within
from bojax.report.claims.samples import Measure, episodes_in, paired, score, stand_ins
from bojax.report.claims.settings import Trend
from bojax.report.source import Results


def trend(results: Results, test: Trend) -> Finding:
    """Whether a mean falls, or rises, between two steps or between two windows of episodes.

    Between steps, a run that has ended keeps its last value, as in the figures.
    """
    label = test.label
    first, last = (Measure(test.column, place) for place in (test.first, test.last))
    (point,), chosen = stand_ins(results, test, [label], score(results, last))
    changes = np.subtract(*(paired(results, [label], [point], end)[:, 0] for end in (last, first)))
    interval = statistics.mean_interval(changes)
    between = f"from {_place(test.first)} to {_place(test.last)}"
    return Finding(
        ours=interval.estimate,
        verdict=within(interval, 0.0, None) if test.direction == "rises" else within(interval, None, 0.0),
        comparisons=[(comparison := Comparison(f"change of {label} {between}", interval))],
        decisive=comparison,
        runs=int(changes.size),
        method=f"mean change of {test.column} {between} within a run, 95% interval "
        f"against 0 (the claim: it {test.direction}); {bootstrap(changes.size)}",
        chosen=chosen,
    )


def _place(place: int | Window) -> str:
    return f"step {place}" if isinstance(place, int) else episodes_in(place)
