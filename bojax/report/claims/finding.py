"""The result of a test, and how an interval decides."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from bojax.report import statistics

Verdict = Literal["reproduced", "not reproduced", "inconclusive"]


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


def bootstrap(runs: int) -> str:
    """The bootstrap of a number of runs, in words."""
    return f"percentile bootstrap, {statistics.RESAMPLES:,} resamples of {statistics.resampled(runs)}"


def interval_of(runs: int, *, is_share: bool = False) -> str:
    """The kind of interval that a comparison of a number of runs has, in words."""
    if is_share:
        return "score intervals of paired shares (Newcombe 1998; Zou and Donner 2008)"
    return bootstrap(runs) if runs >= statistics.FEW else "Student's t, by the jackknife"
