"""The result of a test, and how an interval decides."""

import math
from collections.abc import Mapping
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
    def single(
        cls,
        of: str,
        interval: statistics.Interval,
        verdict: Verdict,
        *,
        runs: int,
        method: str,
        chosen: Mapping[str, str],
    ) -> "Finding":
        """The result of a test of one statement, whose estimate is the counterpart of `thesis`."""
        comparison = Comparison(of, interval)
        return cls(interval.estimate, verdict, [comparison], comparison, runs, method, chosen)


def bootstrap(runs: int) -> str:
    """The bootstrap of a number of runs, in words."""
    return f"percentile bootstrap, {statistics.RESAMPLES:,} resamples of {statistics.resampled(runs)}"


def within(interval: statistics.Interval, low: float | None, high: float | None) -> Verdict:
    """Whether a quantity lies between two bounds, None for no bound: all of its interval does, or none."""
    low, high = -math.inf if low is None else low, math.inf if high is None else high
    if low < interval.low and interval.high < high:
        return "reproduced"
    if interval.high < low or interval.low > high:
        return "not reproduced"
    return "inconclusive"
