"""Claims of the thesis against the data of one sweep: every verdict comes from a stated statistical test.

A test kind is one function of the results and the claim's `test` mapping, in `TESTS`. A claim holds
(`reproduced`) or fails (`not reproduced`) where an interval excludes the opposite, else it is
`inconclusive`; so it is, with the reason, where data are missing or too few.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise, product
from typing import Any, Literal

import numpy as np

from bojax.report import statistics
from bojax.report.source import Columns, Point, Results
from bojax.report.text import counted, number

Verdict = Literal["reproduced", "not reproduced", "inconclusive"]

MIN_RUNS = 20
"""Fewer runs than this decide nothing: a percentile bootstrap is too narrow for small samples."""

_TAIL = (1 - statistics.LEVEL) / 2
_BOOTSTRAP = f"percentile bootstrap, {statistics.RESAMPLES:,} resamples of whole runs"


class Undecidable(Exception):
    """Why a test cannot be made on these data."""


@dataclass(frozen=True)
class Comparison:
    """One statement that a claim rests on, with its estimate and interval."""

    of: str
    interval: statistics.Interval


@dataclass(frozen=True)
class Finding:
    """What a test found.

    Attributes:
        ours: The counterpart of the claim's `thesis`: a number or a text.
        verdict: Decided by the comparisons.
        comparisons: Every statement tested.
        decisive: The comparison that stands for the claim in `claims.json`.
        runs: Runs per setting.
        method: The test in words.
        chosen: Variant that stood for each label with several.
    """

    ours: float | str
    verdict: Verdict
    comparisons: list[Comparison]
    decisive: Comparison
    runs: int
    method: str
    chosen: Mapping[str, str] = field(default_factory=dict)


def evaluate(results: Results) -> list[dict[str, Any]]:
    """The entries of `claims.json`, one per claim of the sweep, in its order."""
    return [_entry(results, claim) for claim in results.manifest.get("claims") or []]


def order(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the means of a column stand in the order given, each above (or below) the next.

    All settings share their run keys, so neighbours are compared by the mean difference of equal runs,
    one-sided in both directions, with Holm's correction over the pairs. With a margin, a name may fall
    short of the next by that much, or by that share of the next's lead over a baseline (non-inferiority).
    """
    column, margin, baseline = test["column"], float(test.get("margin", 0.0)), test.get("baseline")
    sign, listed = (1.0, test["greater"]) if "greater" in test else (-1.0, test["less"])
    tiers = [[tier] if isinstance(tier, str) else list(tier) for tier in listed]
    ranked = [name for tier in tiers for name in tier]
    names = ranked if baseline in (None, *ranked) else [*ranked, baseline]
    points, chosen = _stand_ins(results, test, names, column, sign)
    table = _paired(results, names, points, column)
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
    low_levels = statistics.holm_levels((means <= 0).mean(axis=0), _TAIL)
    high_levels = statistics.holm_levels((means >= 0).mean(axis=0), _TAIL)
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
        method=f"mean difference of {column} between equal runs{' plus the margin' if margin else ''}, "
        f"each pair of neighbours, one-sided at {_TAIL:.1%} with Holm's correction over "
        f"{counted(len(comparisons), 'pair')}, intervals at the levels that it gives; {_BOOTSTRAP}"
        f"{', one run added in each direction' if is_share else ''}",
        chosen=chosen,
    )


def ratio(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the ratio of the means of a column is the expected one, up to a factor of 1 + tolerance.

    It is where the interval lies within the tolerance, and is not where it lies outside; a wide interval
    that happens to hold the expected ratio decides nothing.
    """
    column, names = test["column"], [test["label"], test["to"]]
    expected, factor = float(test["expected"]), 1.0 + float(test["tolerance"])
    points, chosen = _stand_ins(results, test, names, _score(results, column))
    table = _paired(results, names, points, column)
    interval = statistics.ratio_interval(table[:, 0], table[:, 1])
    if not np.isfinite(interval.low):
        raise Undecidable(f"the means of {column} are not clearly positive: their ratio says nothing")
    bounds = expected / factor, expected * factor
    is_within = bounds[0] <= interval.low and interval.high <= bounds[1]
    is_outside = interval.high < bounds[0] or interval.low > bounds[1]
    is_apart = interval.low > 1 or interval.high < 1
    agrees = ", as claimed" if (interval.estimate > 1) == (expected > 1) else ", unlike what is claimed"
    side = f"{'above' if interval.low > 1 else 'below'} 1{agrees}" if is_apart else "on both sides of 1"
    return Finding(
        ours=interval.estimate,
        verdict="reproduced" if is_within else "not reproduced" if is_outside else "inconclusive",
        comparisons=[(comparison := Comparison(f"{column} of {names[0]} / {names[1]}", interval))],
        decisive=comparison,
        runs=len(table),
        method=f"ratio of the means of {column} over equal runs, 95% interval against "
        f"[{number(bounds[0])}, {number(bounds[1])}], which is {expected:g} up to a factor of {factor:g}; "
        f"the interval lies {side}; {_BOOTSTRAP}",
        chosen=chosen,
    )


def similar(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the means of a column of `steps.parquet` at a step differ by less than a margin, all pairs.

    An equivalence test: simultaneous intervals of all differences, Bonferroni, lie within the margin, or
    one lies outside. The margin may be a share of the spread of the means at another step, which is then
    resampled with them.
    """
    column, names, step = test["column"], list(test["labels"]), int(test["step"])
    margin, spread_at = float(test["margin"]), test.get("spread_at")
    points, chosen = _stand_ins(results, test, names, _score(results, column))
    values = _at_steps(results, names, points, column, [step, int(spread_at or step)])
    at, later = values[:, :, 0], values[:, :, 1]
    means = statistics.bootstrap_means(np.concatenate([at, later], axis=1))
    resampled, spreads = means[:, : len(names)], np.ptp(means[:, len(names) :], axis=1)
    scale = float(np.ptp(later.mean(axis=0)))
    if spread_at is None:
        spreads, scale = np.ones(len(means)), 1.0
    elif not (spreads.min() > 0 and scale > 0):
        raise Undecidable(f"the means of {column} do not differ at step {spread_at}: there is no spread")
    pairs = list(combinations(range(len(names)), 2))
    comparisons = []
    for a, b in pairs:
        differences = (resampled[:, a] - resampled[:, b]) / spreads
        low, high = np.quantile(differences, [_TAIL / len(pairs), 1 - _TAIL / len(pairs)])
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
    unit = "" if spread_at is None else f", as a share of their spread at step {spread_at}"
    return Finding(
        ours=", ".join(f"{name} {number(mean)}" for name, mean in zip(names, at.mean(axis=0), strict=True)),
        verdict=verdict,
        comparisons=comparisons,
        decisive=comparisons[int(np.argmax(extreme))],
        runs=len(at),
        method=f"differences of the mean {column} at step {step}{unit}, within equal runs, simultaneous "
        f"95% intervals (Bonferroni over {counted(len(pairs), 'pair')}) against ±{margin:g}; {_BOOTSTRAP}",
        chosen=chosen,
    )


def share(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the share of runs in which a condition holds is above, or below, a threshold."""
    label, column, within = test["label"], test["column"], test.get("within")
    (point,), chosen = _stand_ins(results, test, [label], _score(results, column))
    if within is not None and not point.ends_at_success:
        raise Undecidable(f"a run of {label} goes on after its success: steps do not tell when that was")
    table = results.runs_of(point)
    hits = np.asarray(_column(table, column), dtype=bool)
    if within is not None:
        hits = hits & (_column(table, "steps") <= within)
    _enough(hits.size, "run")
    interval = statistics.share_interval(hits)
    condition = column if within is None else f"{column} within {counted(int(within), 'step')}"
    above = test.get("above")
    threshold = test["below"] if above is None else above
    return Finding(
        ours=interval.estimate,
        verdict=_against(interval, threshold, is_above=above is not None),
        comparisons=[(comparison := Comparison(f"share of {label} with {condition}", interval))],
        decisive=comparison,
        runs=int(hits.size),
        method=f"Wilson 95% interval of the share of runs with {condition}, against "
        f"{'more' if above is not None else 'less'} than {threshold:g}",
        chosen=chosen,
    )


def trend(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the mean of a column of `steps.parquet` falls, or rises, between two steps.

    A run that has ended keeps its last value, as in the figures.
    """
    label, column, first, last = test["label"], test["column"], int(test["from"]), int(test["to"])
    (point,), chosen = _stand_ins(results, test, [label], _score(results, column))
    values = _at_steps(results, [label], [point], column, [first, last])[:, 0]
    changes = values[:, 1] - values[:, 0]
    interval = statistics.mean_interval(changes)
    direction = test["direction"]
    return Finding(
        ours=interval.estimate,
        verdict=_against(interval, 0.0, is_above=direction == "rises"),
        comparisons=[(comparison := Comparison(f"change of {label} from step {first} to {last}", interval))],
        decisive=comparison,
        runs=int(changes.size),
        method=f"mean change of {column} from step {first} to step {last} within a run, 95% interval "
        f"against 0 (the claim: it {direction}); {_BOOTSTRAP}",
        chosen=chosen,
    )


TESTS: Mapping[str, Callable[[Results, Mapping[str, Any]], Finding]] = {
    "order": order,
    "ratio": ratio,
    "similar": similar,
    "share": share,
    "trend": trend,
}


def _entry(results: Results, claim: Mapping[str, Any]) -> dict[str, Any]:
    test = {key: value for key, value in (claim.get("test") or {}).items() if value is not None}
    entry: dict[str, Any] = {key: claim.get(key) for key in ("id", "source", "claim", "thesis")}
    try:
        if test.get("kind") not in TESTS:
            raise Undecidable(f"no test of kind {test.get('kind')!r}")
        finding = TESTS[test["kind"]](results, test)
    except (Undecidable, KeyError) as error:
        reason = f"the claim's test has no {error}" if isinstance(error, KeyError) else str(error)
        return {
            **entry,
            "ours": None,
            "interval": None,
            "runs": 0,
            "verdict": "inconclusive",
            "test": {**test, "reason": reason},
        }
    return {
        **entry,
        "ours": finding.ours if isinstance(finding.ours, str) else _rounded(finding.ours),
        "interval": _bounds(finding.decisive.interval),
        "runs": finding.runs,
        "verdict": finding.verdict,
        "test": {
            **test,
            "method": finding.method,
            "comparisons": [
                {"of": c.of, "estimate": _rounded(c.interval.estimate), "interval": _bounds(c.interval)}
                for c in finding.comparisons
            ],
            "chosen": dict(finding.chosen),
        },
    }


def _score(results: Results, column: str) -> str:
    """What picks the variant that stands for a label: the return, where runs have one."""
    return "return" if "return" in results.runs else column


def _stand_ins(
    results: Results, test: Mapping[str, Any], names: Sequence[str], scored_by: str, sign: float = 1.0
) -> tuple[list[Point], dict[str, str]]:
    """The points that stand for names; of several of one label the best mean, and which those are."""
    by_variant = test.get("by") == "variant"
    found, chosen = [], {}
    for name in names:
        points = [point for point in results.points if (point.variant if by_variant else point.label) == name]
        points = [point for point in points if results.runs_of(point)["run"].size]
        if not points:
            raise Undecidable(f"no runs of {name}")
        if len(points) > 1:
            means = [sign * _mean(results.runs_of(point), scored_by) for point in points]
            points = [points[int(np.argmax(np.nan_to_num(means, nan=-np.inf)))]]
            chosen[name] = points[0].name
        found.append(points[0])
    return found, chosen


def _mean(table: Columns, column: str) -> float:
    return float(np.mean(_column(table, column)))


def _paired(results: Results, names: Sequence[str], points: Sequence[Point], column: str) -> np.ndarray:
    """Values of a column of `runs.parquet` of equal runs, `[runs, points]`."""
    for name, point in zip(names, points, strict=True):
        values = np.asarray(_column(results.runs_of(point), column), dtype=np.float64)
        _finite(values, name, column)
    table = results.paired(points, column)
    _enough(len(table), "paired run")
    return table


def _at_steps(
    results: Results, names: Sequence[str], points: Sequence[Point], column: str, steps: Sequence[int]
) -> np.ndarray:
    """Values of a column of `steps.parquet` of equal runs, `[runs, points, steps]`.

    A run that has ended keeps its last value.
    """
    if results.num_steps < max(steps):
        longest = results.num_steps
        raise Undecidable(f"no run lasted {counted(max(steps), 'step')}: the longest took {longest}")
    shared = results.shared_runs(points)
    tables = []
    for name, point in zip(names, points, strict=True):
        rows = results.steps_of(point)
        values = _column(rows, column)
        curves = statistics.carry_forward(shared, rows["run"], rows["step"], values, results.num_steps)
        tables.append(curves[:, steps])
        _finite(tables[-1], name, column)
    _enough(len(shared), "paired run" if len(points) > 1 else "run")
    return np.stack(tables, axis=1)


def _column(table: Columns, name: str) -> np.ndarray:
    if name not in table:
        raise Undecidable(f"the results have no column {name}")
    return table[name]


def _finite(values: np.ndarray, name: str, column: str) -> None:
    bad = int((~np.isfinite(values.reshape(len(values), -1)).all(axis=1)).sum())
    if bad:
        raise Undecidable(f"{counted(bad, 'run')} of {name} without a finite {column}")


def _enough(count: int, noun: str) -> None:
    if count < MIN_RUNS:
        raise Undecidable(f"{counted(count, noun)}: at least {MIN_RUNS} are needed for a verdict")


def _against(interval: statistics.Interval, threshold: float, *, is_above: bool) -> Verdict:
    if interval.low > threshold:
        return "reproduced" if is_above else "not reproduced"
    if interval.high < threshold:
        return "not reproduced" if is_above else "reproduced"
    return "inconclusive"


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


def _bounds(interval: statistics.Interval) -> list[float]:
    return [_rounded(interval.low), _rounded(interval.high)]


def _rounded(value: float) -> float:
    # Ten digits: sums in another order differ in the last bits, and the file should not.
    return float(f"{value:.10g}")
