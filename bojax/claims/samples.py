"""The data of a test: the points that its names refer to, and one number per run of each point."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from bojax.claims.settings import Measured
from bojax.config.claims import Test, Window
from bojax.report import statistics
from bojax.report.budgets import times_within
from bojax.report.findings import Undecidable
from bojax.report.ranking import ENDS
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats, Interval
from bojax.report.text import counted

MIN_RUNS = 20
"""Smallest number of runs for a verdict: intervals of fewer runs cover skewed variables too rarely."""


@dataclass(frozen=True)
class Measure:
    """One number per run."""

    column: str  # of `runs.parquet`, unless a place is given
    # A step of `steps.parquet`, where a run that has ended keeps its last value, or a window of episodes, of
    # which the mean is taken.
    place: int | Window | None = None
    since: int | Window | None = None  # a place whose value is subtracted
    # Replaces a missing number of `runs.parquet`, and limits a time to a goal or target: a run that never
    # reached it must not count as sooner than others
    missing: float | None = None
    statistic: Literal["mean", "sd"] = "mean"  # of the episodes of a window

    @classmethod
    def of(cls, test: Measured) -> "Measure":
        """The number that a test's `column`, `step` or `window`, and `since` define."""
        return cls(test.column, test.place, test.since, statistic=test.statistic)

    @property
    def may_lack(self) -> float:
        """Largest share of runs that may lack the value, because they lack the episodes."""
        windows = [place for place in (self.place, self.since) if isinstance(place, Window)]
        return max((window.missing for window in windows), default=0.0)

    @override
    def __str__(self) -> str:
        """Its name in a sentence."""
        if self.place is None and self.missing is not None:
            return f"{self.column} ({self.missing:g} where missing)"
        if self.place is None:
            return self.column
        if isinstance(self.place, int):
            since = "" if self.since is None else f", less that at step {self.since}"
            return f"{self.column} at step {self.place}{since}"
        since = f", less that of {episodes_in(self.since)}" if isinstance(self.since, Window) else ""
        statistic = "mean" if self.statistic == "mean" else "standard deviation of"
        return f"{statistic} {self.column} of {episodes_in(self.place)}{since}"

    def is_share(self, results: Results) -> bool:
        """Whether its values are true or false: a Boolean of a run, or of a single episode."""
        if isinstance(self.place, Window):
            is_one = self.place.first == self.place.last and self.place.phase == "train"
            return is_one and self.since is None and results.episodes[self.column].dtype == bool
        return self.place is None and results.runs[self.column].dtype == bool

    def values(self, results: Results, point: Point, runs: NDArray[Any]) -> NDArray[Any]:
        """Its value in the runs of these indices; NaN where it is missing."""
        values = self._at(self.place, results, point, runs)
        return values if self.since is None else values - self._at(self.since, results, point, runs)

    def _at(
        self, place: int | Window | None, results: Results, point: Point, runs: NDArray[Any]
    ) -> NDArray[Any]:
        table = results.runs_of(point)
        rows = np.searchsorted(table["run"], runs)
        if place is None:
            values = table[self.column][rows]
            if self.missing is None:
                return values
            if self.column in ENDS:
                return times_within(values, self.missing)
            return np.nan_to_num(values, nan=self.missing)
        if isinstance(place, int):
            if results.num_steps < place:
                lasted = f"no run lasted {counted(place, 'step')}"
                raise Undecidable(f"{lasted}: the longest took {results.num_steps}")
            return results.by_step(point, self.column)[rows, place]
        episodes = by_episode(results, point, self.column, place, runs)
        if self.statistic == "mean" or episodes.shape[1] < 2:
            return episodes.mean(axis=1)
        return episodes.std(axis=1, ddof=1)


def stand_ins(
    results: Results, test: Test, measure: Measure, sign: float | None = None
) -> tuple[list[Point], dict[str, str]]:
    """The point that represents each name of a test; of several variants, the best is chosen and named.

    It has the best mean return, if runs have one return: in tests over episodes, and where `sign` is given,
    it has the best mean of the tested measure, the largest times `sign`.
    """
    if sign is None and results.return_column in results.runs and not isinstance(measure.place, Window):
        measure = Measure(results.return_column)
    found, chosen = [], {}
    for name in test.names:
        points = named(results, test, name)
        if len(points) > 1:
            samples = [measure.values(results, point, results.runs_of(point)["run"]) for point in points]
            means = [(sign or 1.0) * float(np.mean(sample)) for sample in samples]
            points = [points[int(np.argmax(np.nan_to_num(means, nan=-np.inf)))]]
            chosen[name] = points[0].name
        found.append(points[0])
    return found, chosen


def named(results: Results, test: Test, name: str) -> list[Point]:
    """The points of a label, or of a variant where the test is by variant, that have runs."""
    points = [point for point in results.run_points if getattr(point, test.by) == name]
    if not points:
        raise Undecidable(f"no runs of {name}")
    return points


def paired(results: Results, test: Test, points: Sequence[Point], measure: Measure) -> NDArray[Any]:
    """A measure in the runs that the points of all names of a test have, `[runs, names]`, all finite.

    Runs without a value are left out if the measure allows it.
    """
    for name, point in zip(test.names, points, strict=True):
        values = measure.values(results, point, results.runs_of(point)["run"])
        if measure.may_lack:
            most_present(values, name, str(measure), measure.may_lack)
        else:
            finite(values, name, str(measure))
    shared = results.shared_runs(points)
    table = np.stack([measure.values(results, point, shared) for point in points], axis=1)
    if measure.may_lack:
        table = table[np.isfinite(table).all(axis=1)]
    enough(len(table), "paired run" if len(points) > 1 else "run")
    return table


def mean_of(results: Results, test: Test, point: Point, measure: Measure) -> tuple[Interval, int, str]:
    """Interval of the mean of a measure over the runs of a point, number of these runs, and the method."""
    values = paired(results, test, [point], measure)[:, 0]
    terms = [dataclasses.replace(measure, since=None)]
    if measure.since is not None:
        terms.append(dataclasses.replace(measure, place=measure.since, since=None))
    if not all(term.is_share(results) for term in terms):
        return statistics.mean_interval(values), len(values), interval_of(len(values))
    runs = results.runs_of(point)["run"]
    flags = np.stack([term.values(results, point, runs) for term in terms], axis=1)
    flags = flags[np.isfinite(flags.astype(np.float64)).all(axis=1)]
    if len(terms) == 1:
        return statistics.share_interval(flags[:, 0]), len(flags), "Wilson"
    return statistics.paired_shares(flags, [1.0, -1.0]), len(flags), interval_of(len(flags), is_share=True)


def by_episode(results: Results, point: Point, name: str, window: Window, runs: NDArray[Any]) -> Floats:
    """A column of `episodes.parquet` in a window, `[runs, episodes]`; NaN where a run had no such episode.

    Counted from the start, a run that its success ended keeps its last value. Counted from the first success,
    only recorded episodes count.
    """
    last, rows = window.last, np.searchsorted(results.runs_of(point)["run"], runs)
    if not results.episodes:
        raise Undecidable("the results have no episodes")
    is_from_start = window.counted_from == "start"
    table = (results.by_episode if is_from_start else results.recorded)(point, name, window.phase)
    if table.shape[1] < last:
        what = "a test after" if window.phase == "test" else "an"
        raise Undecidable(f"no run has {what} episode {last}: the last one is {table.shape[1]}")
    table = table[rows]
    if is_from_start:
        return table[:, window.first - 1 : last]
    is_success = results.recorded(point, "success")[rows] > 0
    first = np.where(is_success.any(axis=1), is_success.argmax(axis=1), table.shape[1])
    wanted = first[:, None] + np.arange(window.first - 1, last)
    padded = np.pad(table, ((0, 0), (0, 1)), constant_values=np.nan)
    return np.take_along_axis(padded, np.minimum(wanted, table.shape[1]), axis=1)


def in_any(results: Results, point: Point, name: str, window: Window) -> NDArray[np.bool_]:
    """Whether a column is true or not zero in some episode of a window, for each run.

    A run that ended within the window counts if it had such an episode before.
    """
    table = by_episode(results, point, name, window, results.runs_of(point)["run"])
    hits = (np.nan_to_num(table) != 0).any(axis=1)
    finite(np.where(hits, 0.0, table.mean(axis=1)), point.name, f"{name} in {episodes_in(window)}")
    return hits


def most_present(values: NDArray[Any], name: str, column: str, missing: float) -> NDArray[np.bool_]:
    """Mask of the finite values, which at most a share `missing` of the runs may lack."""
    is_there = np.isfinite(np.asarray(values, dtype=np.float64))
    lacking = int((~is_there).sum())
    if lacking > missing * is_there.size:
        limit = (
            f"more than {missing:.0%}" if missing else "so that the mean over the rest is another quantity"
        )
        raise Undecidable(f"{lacking} of {counted(is_there.size, 'run')} of {name} have no {column}, {limit}")
    return is_there


def flags(values: NDArray[Any], name: str, column: str) -> NDArray[np.bool_]:
    """Whether the value of each run is true or not zero; refuses text, and runs without a value."""
    if values.dtype.kind not in "bfiu":
        raise Undecidable(f"{column} holds neither Booleans nor numbers")
    finite(values, name, column)
    return values.astype(bool)


def finite(values: NDArray[Any], name: str, column: str) -> None:
    """Refuse values that are not finite."""
    bad = int((~np.isfinite(np.asarray(values, dtype=np.float64))).sum())
    if bad:
        raise Undecidable(f"{counted(bad, 'run')} of {name} without a finite {column}")


def enough(count: int, noun: str) -> None:
    """Refuse fewer runs than a verdict needs."""
    if count < MIN_RUNS:
        raise Undecidable(f"{counted(count, noun)}: at least {MIN_RUNS} are needed for a verdict")


def refuse_any_share(margin: float | None) -> None:
    """Refuse a margin that holds for any two shares."""
    if margin is not None and margin >= 1:
        raise Undecidable(f"a margin of {margin:g} holds for any two shares; allowed: < 1")


def episodes_in(window: Window) -> str:
    """A window in words."""
    tests = "the tests after " if window.phase == "test" else ""
    first, last = window.first, window.last
    origin = "" if window.counted_from == "start" else ", counted from the first success"
    return f"{tests}episode{f' {first}' if first == last else f's {first} to {last}'}{origin}"


def bootstrap(runs: int) -> str:
    """The bootstrap of a number of runs, in words."""
    return f"percentile bootstrap, {statistics.RESAMPLES:,} resamples of {statistics.resampled(runs)}"


def interval_of(runs: int, *, is_share: bool = False) -> str:
    """The kind of interval that a comparison of a number of runs has, in words."""
    if is_share:
        return "score intervals of paired shares (Newcombe 1998; Zou and Donner 2008)"
    return bootstrap(runs) if runs >= statistics.FEW else "Student's t, by the jackknife"
