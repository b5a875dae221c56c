"""Test of an order: whether means are in the order that a claim states."""

import dataclasses
from itertools import pairwise, product

import numpy as np

from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding, bootstrap
from bojax.report.claims.samples import Measure, paired, stand_ins
from bojax.report.claims.settings import Order
from bojax.report.source import Results
from bojax.report.text import counted, number


def order(results: Results, test: Order) -> Finding:
    """Whether the means of a column are in the given order, each above (or below) the next.

    Runs with the same index share their key, so neighbours are compared by the mean difference of paired
    runs, one-sided in both directions, with Holm's correction over the pairs. With a margin, a mean may fall
    short of the next by that amount, or by that share of the lead of the next over a baseline
    (non-inferiority). With a negative margin it has to exceed the next by that much.
    """
    measure = dataclasses.replace(Measure.of(test), missing=test.censored_at)
    margin, baseline = test.margin, test.baseline
    sign, tiers = (-1.0 if test.greater is None else 1.0), test.tiers
    points, chosen = stand_ins(results, test, measure, sign)
    table = paired(results, test, points, measure)
    values = dict(zip(test.names, np.asarray(table, dtype=np.float64).T, strict=True))

    def ahead(above: str, below: str) -> tuple[str, statistics.Floats]:
        of = f"{above} - {below}" if sign > 0 else f"{below} - {above}"
        return of, sign * (values[above] - values[below])

    # Each pair: the difference of paired runs, and the allowance of the margin. The mean of their sum has to
    # be positive.
    told, differences, allowances = [], [], []
    added = f"{'+' if margin > 0 else '-'} {abs(margin):g}"
    for a, b in (pair for above, below in pairwise(tiers) for pair in product(above, below)):
        of, difference = ahead(a, b)
        allowance = np.full_like(difference, margin)
        if margin and baseline is None:
            of += f" {added}"
        elif margin and baseline is not None:
            lead, allowance = ahead(b, baseline)
            of, allowance = f"{of} {added} ({lead})", margin * allowance
        told.append(of)
        differences.append(difference)
        allowances.append(allowance)
    sample = np.stack(differences, axis=1) + np.stack(allowances, axis=1)
    estimates = sample.mean(axis=0)
    is_share = table.dtype == bool
    if is_share:
        # One added run in each direction (Bonett and Price 2012), since few or no runs may differ.
        allowed = np.mean(allowances, axis=1)
        sample = np.vstack([sample, allowed + 1.0, allowed - 1.0])
    means = statistics.bootstrap_means(sample)
    low_levels = statistics.holm_levels((means <= 0).mean(axis=0), statistics.TAIL)
    high_levels = statistics.holm_levels((means >= 0).mean(axis=0), statistics.TAIL)
    comparisons = []
    for pair, of in enumerate(told):
        low = float(np.quantile(means[:, pair], low_levels[pair]))
        high = float(np.quantile(means[:, pair], 1 - high_levels[pair]))
        comparisons.append(Comparison(of, statistics.Interval(float(estimates[pair]), low, high)))
    by_mean = sorted((name for tier in tiers for name in tier), key=lambda name: -sign * values[name].mean())
    return Finding.between(
        0.0,
        None,
        comparisons,
        ours=(" > " if sign > 0 else " < ").join(f"{name} {number(values[name].mean())}" for name in by_mean),
        runs=len(table),
        method=f"mean difference of {measure} between paired runs{' plus the margin' if margin else ''}, "
        f"each pair of neighbours, one-sided at {statistics.TAIL:.1%} with Holm's correction over "
        f"{counted(len(comparisons), 'pair')}, intervals at the corrected levels; {bootstrap(len(table))}"
        f"{', one run added in each direction' if is_share else ''}",
        chosen=chosen,
    )
