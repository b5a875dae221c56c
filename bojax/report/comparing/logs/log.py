"""The log of one run of another library: its columns, and the curve of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from bojax.config.errors import shown
from bojax.report.statistics import Floats
from bojax.results.store import ResultsError

LARGEST_STEP, LARGEST_VALUE = 2.0**53, 1e75  # two steps stay two numbers, and fourth powers are finite


@dataclass(frozen=True, eq=False)
class Logged:
    """The values of a column of one run."""

    steps: Floats  # `[n]` environment steps so far, ascending
    values: Floats  # `[n]`
    is_episodic: bool = False  # whether there is a value for every episode


Columns: TypeAlias = Mapping[str, Callable[[], Logged]]
"""Columns of a run by name; each is read when it is asked for."""


@dataclass(frozen=True, eq=False)
class Log:
    """One run of another library."""

    label: str  # name of the method
    run: int | None  # number in the name of the run, None if it has none
    group: Path | None  # runs of one label and group are runs of one method
    source: Path  # what the command names
    path: Path  # for messages
    columns: Columns


def logged(where: str, steps: Floats, values: Floats, *, is_episodic: bool = False) -> Logged:
    """The values of a column, without those that are NaN; of equal steps, the last one counts.

    Steps that go backwards and numbers out of their ranges are refused; `where` names file and column.
    """
    known = ~np.isnan(values)
    steps, values = steps[known], values[known]
    if not values.size:
        raise ResultsError(f"{where}: has no values; allowed: at least one")
    if (wrong := ~((steps >= 0) & (steps <= LARGEST_STEP))).any():
        raise ResultsError(f"{where}: got step {steps[wrong][0]:g}; allowed: from 0 to {LARGEST_STEP:g}")
    if (wrong := ~(np.abs(values) <= LARGEST_VALUE)).any():
        raise ResultsError(f"{where}: got {values[wrong][0]:g}; allowed: a finite number")
    if (back := np.flatnonzero(np.diff(steps) < 0)).size:
        before, after = steps[back[0]], steps[back[0] + 1]
        raise ResultsError(
            f"{where}: steps go backwards, from {before:,.10g} to {after:,.10g}; allowed: one run, "
            "whose steps ascend"
        )
    is_last = np.append(np.diff(steps) > 0, True)
    return Logged(steps[is_last], values[is_last], is_episodic)


def as_number(cell: str, where: str) -> float:
    """A cell of a table, NaN if it is empty."""
    try:
        return float(cell) if cell.strip() else float("nan")
    except ValueError:
        raise ResultsError(f"{where}: got {shown(cell)}; allowed: a number") from None
