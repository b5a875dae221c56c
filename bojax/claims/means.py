"""Tests of means and shares: against a threshold or a printed number, over time, ratio and equivalence."""

import dataclasses
from itertools import combinations
from typing import Any

import numpy as np

from bojax.claims.samples import (
    Measure,
    enough,
    episodes_in,
    finite,
    flags,
    in_any,
    interval_of,
    mean_of,
    most_present,
    paired,
    refuse_any_share,
    stand_ins,
)
from bojax.claims.settings import Agrees, Mean, Ratio, Share, Similar, Trend
from bojax.config.claims import Window
from bojax.report import statistics
from bojax.report.findings import Comparison, Finding, Undecidable
from bojax.report.source import Point, Results
from bojax.report.text import counted, number, percent

SHARE_TOLERANCE = 0.25
"""Default of `agrees` for a share: with 20 printed runs the interval reaches up to 0.22 beyond ours."""


def mean(results: Results, test: Mean) -> Finding:
    """Whether a mean, or each of several, is above a threshold, below one, or between two."""
    measure = Measure.of(test)
    if test.also:
        return _means(results, test, measure)
    (point,), chosen = stand_ins(results, test, measure)
    interval, runs, method = mean_of(results, test, point, measure)
    sides = {"above": test.above, "below": test.below}
    known = {side: bound for side, bound in sides.items() if bound is not None}
    if measure.is_share(results) and not all(0 <= bound <= 1 for bound in known.values()):
        raise Undecidable(f"the mean of {measure} is a share; allowed: thresholds from 0 to 1")
    bounds = " and ".join(f"{side} {bound:g}" for side, bound in known.items())
    return Finding.between(
        test.above,
        test.below,
        [Comparison(f"{measure} of {test.label}", interval)],
        runs=runs,
        method=f"mean over runs of {measure}, 95% interval against {bounds}; {method}",
        chosen=chosen,
    )


def _means(results: Results, test: Mean, measure: Measure) -> Finding:
    """Whether all of several means are above a threshold, or below it (Holm's correction over the means)."""
    (point,), chosen = stand_ins(results, test, measure)
    measures = [dataclasses.replace(measure, column=column) for column in (test.column, *test.also)]
    if any(each.is_share(results) for each in measures):
        raise Undecidable(f"{test.column} or another column holds Booleans: test their shares one by one")
    table = np.stack([paired(results, test, [point], each)[:, 0] for each in measures], axis=1)
    table = table.astype(np.float64)
    side, threshold = ("above", test.above) if test.below is None else ("below", test.below)
    assert threshold is not None  # the schema requires one
    comparisons = []
    for each, interval in zip(measures, statistics.holm_intervals(table - threshold), strict=True):
        shifted = statistics.Interval(*(bound + threshold for bound in dataclasses.astuple(interval)))
        comparisons.append(Comparison(f"{each} of {test.label}", shifted))
    ours = ", ".join(
        f"{each.column} {number(mean)}" for each, mean in zip(measures, table.mean(axis=0), strict=True)
    )
    return Finding.between(
        test.above,
        test.below,
        comparisons,
        ours=ours,
        runs=len(table),
        method=f"means over runs of {counted(len(measures), 'column')}, each {side} {threshold:g}, one-sided "
        f"at {statistics.tail_in_use():.1%} with Holm's correction over the columns, intervals at these "
        f"levels; "
        f"{interval_of(len(table))}",
        chosen=chosen,
    )


def share(results: Results, test: Share) -> Finding:
    """Whether the share of runs that meet a condition is above, or below, a threshold."""
    label, limit, window = test.label, test.within, test.window
    (point,), chosen = stand_ins(results, test, Measure(test.column, window))
    if limit is not None and not point.ends_at_success:
        raise Undecidable(
            f"a run of {label} continues after its success, so its steps do not say when it succeeded"
        )
    if window is None:
        hits = flags(results.runs_of(point)[test.column], label, test.column)
    else:
        hits = in_any(results, point, test.column, window)
    condition = test.column
    if limit is not None:
        hits = hits & (results.runs_of(point)["steps"] <= limit)
        condition += f" within {counted(limit, 'step')}"
    if window is not None:
        condition += f" in {'' if window.first == window.last else 'any of '}{episodes_in(window)}"
    enough(hits.size, "run")
    interval = statistics.share_interval(hits)
    threshold = f"less than {test.below:g}" if test.above is None else f"more than {test.above:g}"
    return Finding.between(
        test.above,
        test.below,
        [Comparison(f"share of {label} with {condition}", interval)],
        runs=int(hits.size),
        method=f"Wilson 95% interval of the share of runs with {condition}, against {threshold}",
        chosen=chosen,
    )


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
    """Change of the mean from the first step to the later ones, over runs that have not ended."""
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


def similar(results: Results, test: Similar) -> Finding:
    """Whether all means differ by less than a margin or a factor: of runs, over episodes, or at a step.

    This is an equivalence test: the claim is reproduced if the simultaneous (Bonferroni) intervals of all
    differences lie within the margin, or of all ratios within the factor, and not reproduced if one lies
    outside. The margin may be a share of the range of the means at another step or over other episodes,
    which is resampled with the means.
    """
    names, spread_at = test.names, test.spread_at
    measure = Measure.of(test)
    spread = measure if spread_at is None else Measure(test.column, spread_at)
    points, chosen = stand_ins(results, test, measure)
    is_share, is_ratio = measure.is_share(results) and spread_at is None, test.factor is not None
    if is_share:
        refuse_any_share(test.margin)
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
    tail, ours = statistics.tail_in_use() / len(pairs), at.mean(axis=0)

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


def agrees(results: Results, test: Agrees) -> Finding:
    """Whether our number may equal the printed one, and differs from it by less than a tolerance.

    The interval of the difference has to lie within the tolerance, and a test that both are equal must not
    reject: for means, Welch's interval then contains 0; for shares, Fisher's exact test decides, because
    Newcombe's interval excludes 0 too often for shares near 0 or 1 of few printed runs. The error of the
    printed number follows from its standard deviation or share and its number of runs. A printed deviation
    of 0 is replaced by ours: it says that no printed run differed from the others, not that none could.

    Runs without a value are left out if the claim allows it (`missing`): a mean printed over the successful
    runs is comparable with ours only if nearly all of our runs succeed.
    """
    label, name, runs = test.label, test.column, test.runs
    (point,), chosen = stand_ins(results, test, Measure(name))
    values = results.runs_of(point)[name]
    enough(values.size, "run")
    if test.share is not None:
        from scipy import stats  # takes half a second to import, and few reports need it

        if test.missing and values.dtype.kind == "f":
            values = values[most_present(values, label, name, test.missing)]
            enough(values.size, "run")
        size, hits = values.size, int(flags(values, label, name).sum())
        printed = round(test.share * runs)
        interval = statistics.share_difference(hits, size, printed, runs)
        result: Any = stats.fisher_exact([[hits, size - hits], [printed, runs - printed]])
        p_value = float(result.pvalue)
        is_apart = p_value < 2 * statistics.tail_in_use()
        estimate, tolerance = hits / size, test.tolerance or SHARE_TOLERANCE
        ours, theirs = percent(estimate), f"{percent(test.share)} of {counted(runs, 'run')}"
        what = f"Newcombe's 95% interval of the difference between our share of {name}"
        rule = f"Fisher's exact test must not tell the shares apart (p = {number(p_value)})"
    else:
        assert test.mean is not None and test.sd is not None  # the schema requires these or a share
        values = values[most_present(values, label, name, test.missing)].astype(np.float64)
        enough(size := values.size, "run")
        estimate, sd = float(values.mean()), float(values.std(ddof=1))
        interval = statistics.welch_difference((estimate, sd, size), (test.mean, test.sd or sd, runs))
        is_apart = interval.low > 0 or interval.high < 0
        tolerance = test.tolerance or test.sd
        ours = f"{number(estimate)} (sd {number(sd)}, {counted(size, 'run')})"
        theirs = f"{number(test.mean)} (sd {number(test.sd)}{'' if test.sd else ', taken as ours'}, "
        theirs += f"{counted(runs, 'run')})"
        what = f"Welch's 95% interval of the difference between our mean {name}"
        rule = "to contain 0"
    is_close = -tolerance < interval.low and interval.high < tolerance
    comparison = Comparison(f"{name} of {label} - published", interval)
    return Finding(
        ours=estimate,
        verdict="not reproduced" if is_apart else "reproduced" if is_close else "inconclusive",
        comparisons=[comparison],
        decisive=comparison,
        runs=size,
        method=f"{what}, {ours}, and the published one, {theirs}: it has to lie within ±{tolerance:g}, and "
        + rule,
        chosen=chosen,
    )
