"""Tests that compare means with each other: their order, their ratio, whether they are the same."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np

from bojax.report import statistics
from bojax.report.claims.finding import TAIL, Comparison, Finding, Verdict, bootstrap, within
from bojax.report.claims.samples import Measure, Undecidable, paired, score, stand_ins
from bojax.report.source import Results
from bojax.report.text import counted, number


def order(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the means of a column stand in the order given, each above (or below) the next.

    All settings share their run keys, so neighbours are compared by the mean difference of equal runs,
    one-sided in both directions, with Holm's correction over the pairs. With a margin, a name may fall
    short of the next by that much, or by that share of the next's lead over a baseline (non-inferiority).
    """
    measure, margin, baseline = Measure.of(test), float(test.get("margin", 0.0)), test.get("baseline")
    sign, listed = (1.0, test["greater"]) if "greater" in test else (-1.0, test["less"])
    tiers = [[tier] if isinstance(tier, str) else list(tier) for tier in listed]
    ranked = [name for tier in tiers for name in tier]
    names = ranked if baseline in (None, *ranked) else [*ranked, baseline]
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
        # One run more in each direction (Bonett and Price 2012), since few runs may differ, or none.
        allowed = np.array([link.allowance.mean() for link in links])
        sample = np.vstack([sample, allowed + 1.0, allowed - 1.0])
    means = statistics.bootstrap_means(sample)
    low_levels = statistics.holm_levels((means <= 0).mean(axis=0), TAIL)
    high_levels = statistics.holm_levels((means >= 0).mean(axis=0), TAIL)
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
    by_mean = sorted(ranked, key=lambda name: -sign * values[name].mean())
    return Finding(
        ours=(" > " if sign > 0 else " < ").join(f"{name} {number(values[name].mean())}" for name in by_mean),
        verdict=verdict,
        comparisons=comparisons,
        decisive=min(
            comparisons, key=lambda c: c.interval.high if verdict == "not reproduced" else c.interval.low
        ),
        runs=len(table),
        method=f"mean difference of {measure} between equal runs{' plus the margin' if margin else ''}, "
        f"each pair of neighbours, one-sided at {TAIL:.1%} with Holm's correction over "
        f"{counted(len(comparisons), 'pair')}, intervals at the levels that it gives; {bootstrap(len(table))}"
        f"{', one run added in each direction' if is_share else ''}",
        chosen=chosen,
    )


def ratio(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the ratio of the means of a column is the expected one, up to a factor of 1 + tolerance.

    It is where the interval lies within the tolerance, and is not where it lies outside; a wide interval
    that happens to hold the expected ratio decides nothing.
    """
    measure, names = Measure.of(test), [test["label"], test["to"]]
    expected, factor = float(test["expected"]), 1.0 + float(test["tolerance"])
    points, chosen = stand_ins(results, test, names, score(results, measure))
    table = paired(results, names, points, measure)
    interval = statistics.ratio_interval(table[:, 0], table[:, 1])
    if not np.isfinite(interval.low):
        raise Undecidable(f"the means of {measure} are not clearly positive: their ratio says nothing")
    bounds = expected / factor, expected * factor
    is_apart = interval.low > 1 or interval.high < 1
    agrees = ", as claimed" if (interval.estimate > 1) == (expected > 1) else ", unlike what is claimed"
    side = f"{'above' if interval.low > 1 else 'below'} 1{agrees}" if is_apart else "on both sides of 1"
    return Finding(
        ours=interval.estimate,
        verdict=within(interval, *bounds),
        comparisons=[(comparison := Comparison(f"{measure} of {names[0]} / {names[1]}", interval))],
        decisive=comparison,
        runs=len(table),
        method=f"ratio of the means of {measure} over equal runs, 95% interval against "
        f"[{number(bounds[0])}, {number(bounds[1])}], which is {expected:g} up to a factor of {factor:g}; "
        f"the interval lies {side}; {bootstrap(len(table))}",
        chosen=chosen,
    )


def similar(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether means differ by less than a margin, all pairs: of runs, over episodes, or at a step.

    An equivalence test: simultaneous intervals of all differences, Bonferroni, lie within the margin, or
    one lies outside. The margin may be a share of the spread of the means at another step or over other
    episodes, which is then resampled with them.
    """
    names, margin, spread_at = list(test["labels"]), float(test["margin"]), test.get("spread_at")
    measure = Measure(test["column"], test.get("step", test.get("window")), test.get("since"))
    spread = measure if spread_at is None else Measure(test["column"], spread_at)
    points, chosen = stand_ins(results, test, names, score(results, measure))
    at, later = (paired(results, names, points, each).astype(np.float64) for each in (measure, spread))
    means = statistics.bootstrap_means(np.concatenate([at, later], axis=1))
    resampled, spreads = means[:, : len(names)], np.ptp(means[:, len(names) :], axis=1)
    scale = float(np.ptp(later.mean(axis=0)))
    if spread_at is None:
        spreads, scale = np.ones(len(means)), 1.0
    elif not (spreads.min() > 0 and scale > 0):
        raise Undecidable(f"the means of {spread} do not differ: there is no spread")
    pairs = list(combinations(range(len(names)), 2))
    comparisons = []
    for a, b in pairs:
        differences = (resampled[:, a] - resampled[:, b]) / spreads
        low, high = np.quantile(differences, [TAIL / len(pairs), 1 - TAIL / len(pairs)])
        estimate = float((at[:, a] - at[:, b]).mean()) / scale
        interval = statistics.Interval(estimate, float(low), float(high))
        comparisons.append(Comparison(f"{names[a]} - {names[b]}", interval))
    verdict: Verdict = "inconclusive"
    if all(-margin < c.interval.low and c.interval.high < margin for c in comparisons):
        verdict = "reproduced"
    elif any(c.interval.low > margin or c.interval.high < -margin for c in comparisons):
        verdict = "not reproduced"
    ends = np.array([(c.interval.low, -c.interval.high) for c in comparisons])
    extreme = ends.max(axis=1) if verdict == "not reproduced" else -ends.min(axis=1)
    unit = "" if spread_at is None else f", as a share of the spread of {spread}"
    return Finding(
        ours=", ".join(f"{name} {number(mean)}" for name, mean in zip(names, at.mean(axis=0), strict=True)),
        verdict=verdict,
        comparisons=comparisons,
        decisive=comparisons[int(np.argmax(extreme))],
        runs=len(at),
        method=f"differences of the means of {measure}{unit}, within equal runs, simultaneous "
        f"95% intervals (Bonferroni over {counted(len(pairs), 'pair')}) against ±{margin:g}; "
        f"{bootstrap(len(at))}",
        chosen=chosen,
    )


@dataclass(frozen=True)
class _Link:
    """What has to be positive in every mean: a difference within runs, and what a margin adds to it."""

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
