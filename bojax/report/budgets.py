"""Runs of different length on common axes: the budget that settings share, and what a run counts with at it.

A budget is a number of steps or episodes. A run that has ended keeps its last value. This is exact if a
success ended the run, or if a planning episode is over. A run that ended early otherwise was cut off.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bojax.report.statistics import Floats, Interval, time_interval

KEPT = "A run that its success ended keeps its last value."
"""Sentence of the captions of figures by episode, where some run ended so."""

SHARE = 0.1  # part of a run, up to the budget, whose values make its score


@dataclass(frozen=True, eq=False)
class Series:
    """The values that one run logged."""

    x: Floats  # `[n]` steps or episodes at which they were logged, in ascending order
    values: Floats  # `[n]`
    end: float  # step or episode at which the run ended, at least the last of `x`
    is_final: bool = False  # whether its last value holds at every later place

    def at(self, places: Floats) -> Floats:
        """The last value logged up to each place, `[n]`; NaN before the first."""
        known = np.append(np.nan, self.values)
        return known[np.searchsorted(self.x, places, side="right")]

    def score(self, budget: float, last: int | None = None) -> float:
        """Mean of the last values logged up to a budget; NaN if there are none.

        These are the last `last` values, or by default those in the last tenth of the run up to the budget,
        at least one. Of a run that is final by then, it is the last value alone, which holds from then on.
        """
        known = self.values[self.x <= budget]
        if not known.size:
            return float("nan")
        if self.is_final and self.end <= budget:
            last = 1
        if last is None:
            end = min(self.end, budget)
            last = max(1, int((self.x[: known.size] > end - SHARE * end).sum()))
        return float(known[-last:].mean())

    def is_cut_off(self, budget: float) -> bool:
        """Whether the run ended before a budget, by its longest interval between values or more."""
        interval = np.diff(self.x).max(initial=0.0)
        return not self.is_final and self.end < budget and self.end + interval <= budget


def budget_of(runs: Iterable[Series]) -> float:
    """The budget of a setting: where its longest run ended, or infinity if all its runs are final."""
    every = [*runs]
    return float("inf") if all(run.is_final for run in every) else max(run.end for run in every)


def common_budget(settings: Sequence[Sequence[Series]]) -> float:
    """The largest budget that all settings have; where their last run ended if all runs are final."""
    least = min(map(budget_of, settings))
    return least if np.isfinite(least) else max(run.end for runs in settings for run in runs)


def held(table: Floats, ends: NDArray[np.integer], is_final: NDArray[np.bool_]) -> Floats:
    """Fill the values of a setting `[runs, n]`: a final run keeps its value at its last column, `ends`.

    Other runs are NaN after their end. Nothing is kept beyond the budget of the setting: a mean over its
    final runs alone would be one over other runs than before.
    """
    columns = np.arange(table.shape[1])
    last = np.clip(ends, 0, None)[:, None]
    kept = np.take_along_axis(table, np.minimum(columns, last), axis=1)
    kept[~is_final] = np.where(columns <= last, table, np.nan)[~is_final]
    return within_budget(kept, ends, is_final)


def within_budget(table: Floats, ends: NDArray[np.integer], is_final: NDArray[np.bool_]) -> Floats:
    """Values of a setting `[runs, n]`, NaN after the last end of a run unless all runs are final."""
    if is_final.all():
        return table
    return np.where(np.arange(table.shape[1]) > ends.max(), np.nan, table)


def times_within(times: Floats, budget: float) -> Floats:
    """Times to an event, NaN for never, up to a budget, with which a run without the event by then counts.

    The mean is the restricted mean time to the event. A run that ended early without the event does not count
    with its own end, since it would gain by ending.
    """
    return np.fmin(times, budget)


def limit_of(times: Floats, ends: Floats, counted: Floats) -> float:
    """The longest end of runs, beyond which no mean time to an event can lie.

    The times are those of all runs of a setting, NaN for never, and `counted` is what they count with. It is
    infinite if every run ended with its event, since nothing then limited the time.
    """
    is_limited = ((ends > times) | (counted != times)).any()
    return float(max(ends.max(), counted.max())) if is_limited else np.inf


def interval_of_times(times: Floats, ends: Floats, counted: Floats) -> Callable[[Floats], Interval]:
    """What gives the interval of mean times to an event, between 1 and the limit of the runs."""
    most = limit_of(times, ends, counted)
    return lambda chosen: time_interval(chosen).within(1.0, most)
