"""Claims of the thesis against the data of one sweep: every verdict comes from a stated statistical test.

A test kind is one function of the results and the claim's `test` mapping, in `TESTS`. A claim holds
(`reproduced`) or fails (`not reproduced`) where an interval excludes the opposite, else it is
`inconclusive`; so it is, with the reason, where data are missing or too few.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
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
    """Whether the means of a column stand in the order given, each above the next.

    All settings share their run keys, so neighbours are compared by the mean difference of equal runs,
    one-sided in both directions, with Holm's correction over the pairs.
    """
    column, names = test["column"], list(test["greater"])
    points, chosen = zip(
        *(_stand_in(results, name, test.get("by", "label"), column) for name in names), strict=True
    )
    tables = [results.runs_of(point) for point in points]
    for name, table in zip(names, tables, strict=True):
        _finite(table, column, name)
    shared = tables[0]["run"]
    for table in tables[1:]:
        shared = np.intersect1d(shared, table["run"])
    _enough(shared.size, "paired run")
    values = np.stack([_at(table, column, shared) for table in tables], axis=1)
    differences = values[:, :-1] - values[:, 1:]
    means = statistics.bootstrap_means(differences)
    low_levels = statistics.holm_levels((means <= 0).mean(axis=0), _TAIL)
    high_levels = statistics.holm_levels((means >= 0).mean(axis=0), _TAIL)
    comparisons = []
    for pair, (first, second) in enumerate(zip(names[:-1], names[1:], strict=True)):
        low = float(np.quantile(means[:, pair], low_levels[pair]))
        high = float(np.quantile(means[:, pair], 1 - high_levels[pair]))
        interval = statistics.Interval(float(differences[:, pair].mean()), low, high)
        comparisons.append(Comparison(f"{first} - {second}", interval))
    verdict: Verdict = "inconclusive"
    if all(comparison.interval.low > 0 for comparison in comparisons):
        verdict = "reproduced"
    elif any(comparison.interval.high < 0 for comparison in comparisons):
        verdict = "not reproduced"
    means_of = sorted(zip(values.mean(axis=0), names, strict=True), key=lambda pair: -pair[0])
    return Finding(
        ours=" > ".join(f"{name} {number(mean)}" for mean, name in means_of),
        verdict=verdict,
        comparisons=comparisons,
        decisive=min(
            comparisons, key=lambda c: c.interval.high if verdict == "not reproduced" else c.interval.low
        ),
        runs=int(shared.size),
        method=f"mean difference of {column} between equal runs, each pair of neighbours, one-sided at "
        f"{_TAIL:.1%} with Holm's correction over {counted(len(comparisons), 'pair')}, "
        f"intervals at the levels that it gives; {_BOOTSTRAP}",
        chosen={name: variant for name, variant in zip(names, chosen, strict=True) if variant},
    )


def share(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the share of runs in which a condition holds is above, or below, a threshold."""
    label, column, within = test["label"], test["column"], test.get("within")
    point, chosen = _stand_in(results, label, test.get("by", "label"), _score(results, column))
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
        chosen={label: chosen} if chosen else {},
    )


def trend(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the mean of a column of `steps.parquet` falls, or rises, between two steps.

    A run that has ended keeps its last value, as in the figures.
    """
    label, column, first, last = test["label"], test["column"], int(test["from"]), int(test["to"])
    point, chosen = _stand_in(results, label, test.get("by", "label"), _score(results, column))
    steps, runs = results.steps_of(point), results.runs_of(point)["run"]
    values = _column(steps, column)
    if results.num_steps < last:
        raise Undecidable(f"no run lasted {counted(last, 'step')}: the longest took {results.num_steps}")
    curves = statistics.carry_forward(runs, steps["run"], steps["step"], values, results.num_steps)
    changes = curves[:, last] - curves[:, first]
    _enough(changes.size, "run")
    if not np.isfinite(changes).all():
        raise Undecidable(
            f"{counted(int((~np.isfinite(changes)).sum()), 'run')} of {label} without a finite {column}"
        )
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
        chosen={label: chosen} if chosen else {},
    )


TESTS: Mapping[str, Callable[[Results, Mapping[str, Any]], Finding]] = {
    "order": order,
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


def _stand_in(results: Results, name: str, by: str, scored_by: str) -> tuple[Point, str | None]:
    """The point that stands for a label: of several, the one with the best mean, and then its name."""
    points = [
        point for point in results.points if (point.variant if by == "variant" else point.label) == name
    ]
    points = [point for point in points if results.runs_of(point)["run"].size]
    if not points:
        raise Undecidable(f"no runs of {name}")
    if len(points) == 1:
        return points[0], None
    means = [_mean(results.runs_of(point), scored_by) for point in points]
    best = points[int(np.argmax(means))]
    return best, best.name


def _mean(table: Columns, column: str) -> float:
    mean = float(np.mean(_column(table, column)))
    return mean if np.isfinite(mean) else -np.inf


def _column(table: Columns, name: str) -> np.ndarray:
    if name not in table:
        raise Undecidable(f"the results have no column {name}")
    return table[name]


def _at(table: Columns, column: str, runs: np.ndarray) -> np.ndarray:
    rows = np.searchsorted(table["run"], runs)
    return np.asarray(_column(table, column), dtype=np.float64)[rows]


def _finite(table: Columns, column: str, name: str) -> None:
    bad = int((~np.isfinite(np.asarray(_column(table, column), dtype=np.float64))).sum())
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


def _bounds(interval: statistics.Interval) -> list[float]:
    return [_rounded(interval.low), _rounded(interval.high)]


def _rounded(value: float) -> float:
    # Ten digits: sums in another order differ in the last bits, and the file should not.
    return float(f"{value:.10g}")
