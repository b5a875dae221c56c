"""Test of equivalence: whether means differ by less than a margin."""

from itertools import combinations

import numpy as np

from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding, bootstrap
from bojax.report.claims.samples import Measure, Undecidable, paired, stand_ins
from bojax.report.claims.settings import Similar
from bojax.report.source import Results
from bojax.report.text import counted, number


def similar(results: Results, test: Similar) -> Finding:
    """Whether the means of all pairs differ by less than a margin: of runs, over episodes, or at a step.

    This is an equivalence test: the claim is reproduced if the simultaneous (Bonferroni) intervals of all
    differences lie within the margin, and not reproduced if one lies outside. The margin may be a share of
    the range of the means at another step or over other episodes, which is resampled with the means.
    """
    names, margin, spread_at = test.names, test.margin, test.spread_at
    measure = Measure(test.column, test.step or test.window, test.since)
    spread = measure if spread_at is None else Measure(test.column, spread_at)
    points, chosen = stand_ins(results, test, measure)
    at, later = (paired(results, test, points, each).astype(np.float64) for each in (measure, spread))
    means = statistics.bootstrap_means(np.concatenate([at, later], axis=1))
    resampled, spreads = means[:, : len(names)], np.ptp(means[:, len(names) :], axis=1)
    scale = float(np.ptp(later.mean(axis=0)))
    if spread_at is None:
        spreads, scale = np.ones(len(means)), 1.0
    elif not (spreads.min() > 0 and scale > 0):
        raise Undecidable(f"the means of {spread} do not differ: their range is 0")
    pairs = list(combinations(range(len(names)), 2))
    comparisons = []
    for a, b in pairs:
        differences = (resampled[:, a] - resampled[:, b]) / spreads
        low, high = np.quantile(differences, [statistics.TAIL / len(pairs), 1 - statistics.TAIL / len(pairs)])
        estimate = float((at[:, a] - at[:, b]).mean()) / scale
        interval = statistics.Interval(estimate, float(low), float(high))
        comparisons.append(Comparison(f"{names[a]} - {names[b]}", interval))
    unit = "" if spread_at is None else f", as a share of the range of {spread}"
    return Finding.between(
        -margin,
        margin,
        comparisons,
        ours=", ".join(f"{name} {number(mean)}" for name, mean in zip(names, at.mean(axis=0), strict=True)),
        runs=len(at),
        method=f"differences of the means of {measure}{unit}, within paired runs, simultaneous "
        f"95% intervals (Bonferroni over {counted(len(pairs), 'pair')}) against ±{margin:g}; "
        f"{bootstrap(len(at))}",
        chosen=chosen,
    )
