"""Test of an order: whether means are in the order that a claim states."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding, Verdict, bootstrap
from bojax.report.claims.samples import Measure, paired, stand_ins
from bojax.report.claims.settings import Order
from bojax.report.source import Results
from bojax.report.text import counted, number


def order(results: Results, test: Order) -> Finding:
    """Whether the means of a column are in the given order, each above (or below) the next.

    Runs with the same index share their key, so neighbours are compared by the mean difference of paired
    runs, one-sided in both directions, with Holm's correction over the pairs. With a margin, a mean may fall
    short of the next by that amount, or by that share of the lead of the next over a baseline
    (non-inferiority).
    """
    measure, margin, baseline = Measure.of(test), test.margin, test.baseline
    sign, tiers = (-1.0 if test.greater is None else 1.0), test.tiers
    names = test.names
    points, chosen = stand_ins(results, test, names, measure, sign)
    table = paired(results, names, points, measure)
    values = dict(zip(names, np.asarray(table, dtype=np.float64).T, strict=True))

    links = [
        _link(values, a, b, sign, margin, baseline)
        for above, below in pairwise(tiers)
        for a, b in product(above, below)
    ]
    sample = np.stack([link.difference + link.allowance for link in links], axis=1)
    estimates = sample.mean(axis=0)
    is_share = table.dtype == bool
    if is_share:
        # One added run in each direction (Bonett and Price 2012), since few or no runs may differ.
        allowed = np.array([link.allowance.mean() for link in links])
        sample = np.vstack([sample, allowed + 1.0, allowed - 1.0])
    means = statistics.bootstrap_means(sample)
    low_levels = statistics.holm_levels((means <= 0).mean(axis=0), statistics.TAIL)
    high_levels = statistics.holm_levels((means >= 0).mean(axis=0), statistics.TAIL)
    comparisons = []
    for pair, link in enumerate(links):
        low = float(np.quantile(means[:, pair], low_levels[pair]))
        high = float(np.quantile(means[:, pair], 1 - high_levels[pair]))
        comparisons.append(Comparison(link.of, statistics.Interval(float(estimates[pair]), low, high)))
    verdict: Verdict = "inconclusive"
    if all(comparison.interval.low > 0 for comparison in comparisons):
        verdict = "reproduced"
    elif any(comparison.interval.high < 0 for comparison in comparisons):
        verdict = "not reproduced"
    by_mean = sorted((name for tier in tiers for name in tier), key=lambda name: -sign * values[name].mean())
    return Finding(
        ours=(" > " if sign > 0 else " < ").join(f"{name} {number(values[name].mean())}" for name in by_mean),
        verdict=verdict,
        comparisons=comparisons,
        decisive=min(
            comparisons, key=lambda c: c.interval.high if verdict == "not reproduced" else c.interval.low
        ),
        runs=len(table),
        method=f"mean difference of {measure} between paired runs{' plus the margin' if margin else ''}, "
        f"each pair of neighbours, one-sided at {statistics.TAIL:.1%} with Holm's correction over "
        f"{counted(len(comparisons), 'pair')}, intervals at the corrected levels; {bootstrap(len(table))}"
        f"{', one run added in each direction' if is_share else ''}",
        chosen=chosen,
    )


@dataclass(frozen=True)
class _Link:
    """Two terms whose sum must have a positive mean: a paired difference, and the allowance of the margin."""

    of: str
    difference: statistics.Floats
    allowance: statistics.Floats


def _link(
    values: Mapping[str, statistics.Floats],
    above: str,
    below: str,
    sign: float,
    margin: float,
    baseline: str | None,
) -> _Link:
    difference = sign * (values[above] - values[below])
    if not margin:
        return _Link(_minus(above, below, sign), difference, np.zeros_like(difference))
    if baseline is None:
        of = f"{_minus(above, below, sign)} + {margin:g}"
        return _Link(of, difference, np.full_like(difference, margin))
    of = f"{_minus(above, below, sign)} + {margin:g} ({_minus(below, baseline, sign)})"
    return _Link(of, difference, margin * sign * (values[below] - values[baseline]))


def _minus(above: str, below: str, sign: float) -> str:
    return f"{above} - {below}" if sign > 0 else f"{below} - {above}"
