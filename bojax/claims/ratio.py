"""Test of a ratio: whether two means have the ratio that a claim states."""

import numpy as np

from bojax.claims.samples import Measure, interval_of, paired, stand_ins
from bojax.claims.settings import Ratio
from bojax.report import statistics
from bojax.report.findings import Comparison, Finding, Undecidable
from bojax.report.source import Results
from bojax.report.text import number


def ratio(results: Results, test: Ratio) -> Finding:
    """Whether the ratio of the means of a column is the expected one, up to a factor of 1 + tolerance.

    A ratio on the other side of 1 is the opposite order, and never the expected one. The claim is reproduced
    if the interval lies within these bounds, and not reproduced if it lies outside. A wide interval that
    contains the expected ratio decides nothing.
    """
    measure, expected, factor = Measure.of(test), test.expected, 1.0 + test.tolerance
    points, chosen = stand_ins(results, test, measure)
    table = paired(results, test, points, measure)
    if is_share := measure.is_share(results):
        interval = statistics.paired_shares(table, [1.0, -1.0], is_ratio=True)
    else:
        interval = statistics.ratio_interval(table[:, 0], table[:, 1])
    if not np.isfinite(interval.low):
        raise Undecidable(f"the means of {measure} are not clearly positive: their ratio is meaningless")
    low, high = expected / factor, expected * factor
    low, high = (max(low, 1.0), high) if expected > 1 else (low, min(high, 1.0))
    is_apart = interval.low > 1 or interval.high < 1
    side = f"{'above' if interval.low > 1 else 'below'} 1" if is_apart else "on both sides of 1"
    if is_apart:
        agrees = (interval.estimate > 1) == (expected > 1)
        side += ", as claimed" if agrees else ", contrary to the claim"
    return Finding.between(
        low,
        high,
        [Comparison(f"{measure} of {test.label} / {test.to}", interval)],
        runs=len(table),
        method=f"ratio of the means of {measure} over paired runs, 95% interval against "
        f"[{number(low)}, {number(high)}]: {expected:g} up to a factor of {factor:g} on the same side of 1; "
        f"the interval lies {side}; {interval_of(len(table), is_share=is_share)}",
        chosen=chosen,
    )
