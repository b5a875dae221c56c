"""Simultaneous intervals of several means by Holm's procedure, one-sided in both directions."""

from collections.abc import Callable

import numpy as np

from bojax.claims.samples import enough
from bojax.report import statistics
from bojax.report.statistics import Floats, Interval


def holm_intervals(
    sample: Floats, share_bounds: Callable[[int, float], tuple[float, float]] | None = None
) -> list[Interval]:
    """Interval of the mean of every column of `[runs, columns]`, to be compared with 0.

    Each bound is at the level that Holm's correction over the columns gives to its side. For shares,
    `share_bounds` gives the bounds of a column, by its index and the probability of one tail.
    """
    enough(len(sample), "run")
    means = np.zeros((0, sample.shape[1]))
    is_resampled = share_bounds is None and len(sample) >= statistics.FEW
    if is_resampled:
        means = statistics.bootstrap_means(sample)

    def bounds_at(column: int, tail: float) -> tuple[float, float]:
        if share_bounds is not None:
            return share_bounds(column, tail)
        if is_resampled:
            return statistics.central(means[:, column], tail)
        found = statistics.interval_of_means(lambda means: means, sample[:, column], tail)
        return found.low, found.high

    columns = range(sample.shape[1])
    if is_resampled:
        above, below = (means <= 0).mean(axis=0), (means >= 0).mean(axis=0)
    else:
        above = [statistics.p_value(lambda tail, k=k: bounds_at(k, tail)[0] > 0) for k in columns]
        below = [statistics.p_value(lambda tail, k=k: bounds_at(k, tail)[1] < 0) for k in columns]
    low_tails, high_tails = (
        statistics.holm_levels(each, statistics.tail_in_use()) for each in (above, below)
    )
    return [
        Interval(float(sample[:, k].mean()), bounds_at(k, low_tails[k])[0], bounds_at(k, high_tails[k])[1])
        for k in columns
    ]
