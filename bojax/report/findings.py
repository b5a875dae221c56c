"""The findings of the tests of claims, and the entries of `claims.json` made of them.

A claim is `reproduced` or `not reproduced` where an interval excludes the opposite, and otherwise
`inconclusive`. It is also `inconclusive`, with the reason, where data are missing or too few, or where the
test fails. The tests are the functions that the settings of a test name, see `bojax.claims`.
"""

import importlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field

import numpy as np

from bojax.config.claims import Claim, Test
from bojax.report import statistics
from bojax.report.columns import NoColumn
from bojax.report.manifest import Unread
from bojax.report.source import Results
from bojax.report.verdicts import FailureCause, TestedClaim, Verdict
from bojax.results.store import ResultsError
from bojax.text import error_line


@dataclass(frozen=True)
class Comparison:
    """One statement behind a claim, with its estimate and interval."""

    of: str
    interval: statistics.Interval


@dataclass(frozen=True)
class Finding:
    """The result of a test."""

    ours: float | str  # the counterpart of the claim's `thesis`: a number or a text
    verdict: Verdict  # decided by the comparisons
    comparisons: list[Comparison]  # every statement tested
    decisive: Comparison  # the comparison whose interval represents the claim in `claims.json`
    runs: int  # runs per setting
    method: str  # the test in words
    # The variant that represents each label with several variants
    chosen: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def between(
        cls,
        low: float | None,
        high: float | None,
        comparisons: Sequence[Comparison],
        *,
        ours: float | str | None = None,
        runs: int,
        method: str,
        chosen: Mapping[str, str],
    ) -> "Finding":
        """The result of a test whose quantities all have to lie between two bounds, None for no bound.

        The claim is reproduced if all of them do, and not reproduced if one of them does not. The decisive
        interval is the one that is furthest outside then, and otherwise the one that is least far inside.
        Without `ours`, the estimate of the only quantity is the counterpart of `thesis`.
        """
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        intervals = [comparison.interval for comparison in comparisons]
        if all(low < each.low and each.high < high for each in intervals):
            verdict = "reproduced"
        elif any(each.high < low or each.low > high for each in intervals):
            verdict = "not reproduced"
        else:
            verdict = "inconclusive"
        if verdict == "not reproduced":
            room = [-max(low - each.high, each.low - high) for each in intervals]
        else:
            room = [min(each.low - low, high - each.high) for each in intervals]
        decisive = comparisons[room.index(min(room))]
        ours = decisive.interval.estimate if ours is None else ours
        return cls(ours, verdict, list(comparisons), decisive, runs, method, chosen)


class Undecidable(Exception):
    """The data do not allow a test; the message says why."""


def evaluate(results: Results, claims: Sequence[Claim | Unread] | None = None) -> list[TestedClaim]:
    """The entries of `claims.json` of these claims, by default all of the sweep, in their order."""
    entries = [_entry(results, claim) for claim in (results.claims if claims is None else claims)]
    return [entry.model_copy(update={"cause": cause_of(results, entry)}) for entry in entries]


def cause_of(results: Results, entry: TestedClaim) -> FailureCause | None:
    """The cause of the verdict of an entry of `claims.json`; none of a reproduced claim."""
    causes: dict[str, FailureCause] = {
        name: each.cause for each in results.explanations for name in each.claims
    }
    rest: FailureCause = "untested" if entry.test.reason else "unexplained"
    return None if entry.verdict == "reproduced" else causes.get(entry.id, rest)


def decide(results: Results, test: Test) -> Finding:
    """Make a test."""
    module, _, name = type(test).target.partition(":")
    try:
        return getattr(importlib.import_module(module), name)(results, test)
    except NoColumn as error:
        raise Undecidable(str(error)) from None


def _entry(results: Results, claim: Claim | Unread) -> TestedClaim:
    is_read = isinstance(claim, Claim)
    settings = claim.model_dump(mode="json") if is_read else claim.mapping
    test = claim.test.model_dump(mode="json", exclude_none=True) if is_read else settings.get("test") or {}
    known = {key: settings.get(key) for key in ("id", "source", "claim", "own_bound", "thesis")}
    known |= {"class": settings.get("class", "claim"), "changed": results.manifest.changed}
    try:
        if isinstance(claim, Unread):
            raise Undecidable(claim.reason)
        finding = decide(results, claim.test)
        numbers = [number for each in finding.comparisons for number in astuple(each.interval)]
        if not np.isfinite([*numbers, 0.0 if isinstance(finding.ours, str) else finding.ours]).all():
            raise Undecidable("the numbers are too large for their mean to be finite")
    except ResultsError:
        raise
    except Exception as error:  # a failed test must not cost the other verdicts
        reason = str(error) if isinstance(error, Undecidable) else f"the test failed: {error_line(error)}"
        known |= {"ours": None, "interval": None, "runs": 0, "verdict": "inconclusive"}
        return TestedClaim.model_validate({**known, "test": {**test, "reason": reason}})
    comparisons = [
        {"of": each.of, "estimate": estimate, "interval": [low, high]}
        for each in finding.comparisons
        for estimate, low, high in [map(_rounded, astuple(each.interval))]
    ]
    known |= {
        "ours": finding.ours if isinstance(finding.ours, str) else _rounded(finding.ours),
        "interval": comparisons[finding.comparisons.index(finding.decisive)]["interval"],
        "runs": finding.runs,
        "verdict": finding.verdict,
    }
    found = {"method": finding.method, "comparisons": comparisons, "chosen": dict(finding.chosen)}
    return TestedClaim.model_validate({**known, "test": {**test, **found}})


def _rounded(value: float) -> float:
    # Ten digits: sums in another order differ in the last bits, and the file should not.
    return float(f"{value:.10g}")
