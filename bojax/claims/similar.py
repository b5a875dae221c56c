"""Test of equivalence: whether means differ by less than a margin, or by less than a factor."""

from itertools import combinations

import numpy as np

from bojax.claims.samples import Measure, interval_of, paired, stand_ins
from bojax.claims.settings import Similar
from bojax.report import statistics
from bojax.report.findings import Comparison, Finding, Undecidable
from bojax.report.source import Results
from bojax.report.text import counted, number


def similar(results: Results, test: Similar) -> Finding:
    """Whether all means differ by less than a margin or a factor: of runs, over episodes, or at a step.

    This is an equivalence test: the claim is reproduced if the simultaneous (Bonferroni) intervals of all
    differences lie within the margin, or those of all ratios within the factor, and not reproduced if one
    lies outside. The margin may be a share of the range of the means at another step or over other episodes,
    which is resampled with the means.
    """
    names, spread_at = test.names, test.spread_at
    measure = Measure(test.column, test.step or test.window, test.since)
    spread = measure if spread_at is None else Measure(test.column, spread_at)
    points, chosen = stand_ins(results, test, measure)
    is_share, is_ratio = measure.is_share(results) and spread_at is None, test.factor is not None
    at, later = (paired(results, test, points, each).astype(np.float64) for each in (measure, spread))
    table = np.concatenate([at, later], axis=1)
    means = statistics.bootstrap_means(table)
    spreads = np.ptp(np.vstack([table.mean(axis=0), means])[:, len(names) :], axis=1)
    if spread_at is not None and not spreads.min() > 0:
        raise Undecidable(f"the means of {spread} do not differ: their range is 0")
    if test.factor is None:
        margin = test.margin or 0.0
        low, high, bounds = -margin, margin, f"±{margin:g}"
        compared, sign, compare = "differences", "-", np.subtract
    else:
        low, high, bounds = 1 / test.factor, test.factor, f"a factor of {test.factor:g}"
        compared, sign, compare = "ratios", "/", np.divide
        if not (at.mean(axis=0) if is_share else means[:, : len(names)]).min() > 0:
            raise Undecidable(f"the means of {measure} are not clearly positive: a ratio is meaningless")
    pairs = list(combinations(range(len(names)), 2))
    tail, ours = statistics.TAIL / len(pairs), at.mean(axis=0)

    def between(a: int, b: int) -> statistics.Interval:
        def compared_means(means: statistics.Floats) -> statistics.Floats:
            spreads = 1.0 if spread_at is None else np.ptp(means[..., len(names) :], axis=-1)
            return compare(means[..., a], means[..., b]) / spreads

        if is_share:
            return statistics.paired_shares(at[:, [a, b]], [1.0, -1.0], tail, is_ratio=is_ratio)
        return statistics.interval_of_means(compared_means, table, tail, is_ratio=is_ratio, resampled=means)

    comparisons = [Comparison(f"{names[a]} {sign} {names[b]}", between(a, b)) for a, b in pairs]
    unit = "" if spread_at is None else f", as a share of the range of {spread}"
    return Finding.between(
        low,
        high,
        comparisons,
        ours=", ".join(f"{name} {number(mean)}" for name, mean in zip(names, ours, strict=True)),
        runs=len(at),
        method=f"{compared} of the means of {measure}{unit}, within paired runs, simultaneous "
        f"95% intervals (Bonferroni over {counted(len(pairs), 'pair')}) against {bounds}; "
        f"{interval_of(len(at), is_share=is_share)}",
        chosen=chosen,
    )
