"""Claims of the thesis against the data of one sweep: every verdict comes from a stated statistical test.

A test kind is one function of the results and the claim's `test` mapping, in `TESTS`. A claim holds
(`reproduced`) or fails (`not reproduced`) where an interval excludes the opposite, else it is
`inconclusive`; so it is, with the reason, where data are missing or too few, or where the test fails.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bojax.report import statistics
from bojax.report.claims.comparisons import order, ratio, similar
from bojax.report.claims.finding import Finding
from bojax.report.claims.levels import mean, share, trend
from bojax.report.claims.published import agrees
from bojax.report.claims.samples import MIN_RUNS, Undecidable
from bojax.report.claims.scaling import growth
from bojax.report.source import Results
from bojax.results.store import ResultsError, one_line

__all__ = ["MIN_RUNS", "TESTS", "Undecidable", "evaluate"]

TESTS: Mapping[str, Callable[[Results, Mapping[str, Any]], Finding]] = {
    "order": order,
    "ratio": ratio,
    "similar": similar,
    "share": share,
    "mean": mean,
    "trend": trend,
    "agrees": agrees,
    "growth": growth,
}


def evaluate(results: Results) -> list[dict[str, Any]]:
    """The entries of `claims.json`, one per claim of the sweep, in its order."""
    return [_entry(results, claim) for claim in results.manifest.get("claims") or []]


def _entry(results: Results, claim: Mapping[str, Any]) -> dict[str, Any]:
    test = {key: value for key, value in (claim.get("test") or {}).items() if value is not None}
    entry: dict[str, Any] = {key: claim.get(key) for key in ("id", "source", "claim", "thesis")}
    entry["changed"] = dict(results.changed)
    try:
        if test.get("kind") not in TESTS:
            raise Undecidable(f"no test of kind {test.get('kind')!r}")
        finding = TESTS[test["kind"]](results, test)
        if not _is_finite(finding):
            raise Undecidable("the numbers are too large for their mean to be one")
    except ResultsError:
        raise
    except Exception as error:  # one claim is no reason to lose the others
        return {
            **entry,
            "ours": None,
            "interval": None,
            "runs": 0,
            "verdict": "inconclusive",
            "test": {**test, "reason": _reason(error)},
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


def _is_finite(finding: Finding) -> bool:
    intervals = [finding.decisive.interval, *(comparison.interval for comparison in finding.comparisons)]
    numbers = [number for each in intervals for number in (each.estimate, each.low, each.high)]
    return bool(np.isfinite([*numbers, 0.0 if isinstance(finding.ours, str) else finding.ours]).all())


def _reason(error: Exception) -> str:
    if isinstance(error, Undecidable):
        return str(error)
    if isinstance(error, KeyError):
        return f"the claim's test has no {error}"
    return f"the test failed: {one_line(error)}"


def _bounds(interval: statistics.Interval) -> list[float]:
    return [_rounded(interval.low), _rounded(interval.high)]


def _rounded(value: float) -> float:
    # Ten digits: sums in another order differ in the last bits, and the file should not.
    return float(f"{value:.10g}")
