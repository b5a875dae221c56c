"""Curves of other libraries from CSV files: one row per value, checked with one-line errors."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bojax.config.errors import allowed_names, shown
from bojax.report.statistics import Floats
from bojax.results.store import ResultsError

COLUMNS = ("label", "run", "x", "value")
"""Columns that a file must have."""

TASK = "task"
"""Column that a file may have."""

MAX_RUN = 2**31 - 1
"""Greatest index of a run."""

Key = tuple[str, str]
"""A label and a task."""


@dataclass(frozen=True)
class Rows:
    """The rows of a label."""

    label: str
    task: str  # empty if the file has no such column
    runs: dict[int, tuple[Floats, Floats]]  # x, ascending, and value of each run


def read_curves(path: Path) -> list[Rows]:
    """Read a CSV file with the columns `label, run, x, value` and optionally `task`, in any order.

    Rows may have any order. Labels keep that of their first rows.

    Raises:
        ResultsError: The file cannot be read, a column is missing or unknown, a cell is empty or no number,
            or two rows have the same label, run and x; one line.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return _parsed(path, csv.reader(file, strict=True))
    except UnicodeDecodeError:
        raise ResultsError(f"{path}: cannot be read; allowed: CSV in UTF-8") from None
    except csv.Error as error:
        raise ResultsError(f"{path}: cannot be read ({error}); allowed: CSV") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ResultsError(f"{path}: cannot be read: {reason}") from None


def _parsed(path: Path, lines) -> list[Rows]:
    header = [name.strip() for name in next(lines, [])]
    if not header:
        raise ResultsError(f"{path}: is empty; allowed: the columns {', '.join(COLUMNS)} and rows")
    _check_header(path, header)
    cells: dict[Key, dict[int, dict[float, float]]] = {}
    for line in lines:
        if not line:
            continue
        place = f"{path}: line {lines.line_num}"
        if len(line) != len(header):
            raise ResultsError(f"{place}: got {len(line)} cells; allowed: {len(header)}, as in the header")
        row = dict(zip(header, map(str.strip, line), strict=True))
        for name in {"label", TASK} & row.keys():
            if not row[name]:
                raise ResultsError(f"{place}: {name}: got nothing; allowed: text")
        run, x, value = _run(place, row["run"]), _x(place, row["x"]), _number(place, "value", row["value"])
        values = cells.setdefault((row["label"], row.get(TASK, "")), {}).setdefault(run, {})
        if x in values:
            raise ResultsError(
                f"{place}: x: got {row['x']} of run {run} of {row['label']} twice; allowed: once"
            )
        values[x] = value
    if not cells:
        raise ResultsError(f"{path}: has no rows; allowed: at least one below the header")
    return [
        Rows(label, task, {run: _ordered(values) for run, values in sorted(runs.items())})
        for (label, task), runs in cells.items()
    ]


def _check_header(path: Path, header: Sequence[str]) -> None:
    known = [*COLUMNS, TASK]
    twins = [name for name in header if header.count(name) > 1]
    if twins:
        raise ResultsError(f"{path}: two columns are called {shown(twins[0])}; allowed: one")
    for name in header:
        if name not in known:
            raise ResultsError(f"{path}: unknown column {shown(name)}{allowed_names(name, known)}")
    for name in COLUMNS:
        if name not in header:
            raise ResultsError(f"{path}: no column {name}; allowed: {', '.join(COLUMNS)}, optionally {TASK}")


def _run(place: str, text: str) -> int:
    number = _number(place, "run", text)
    if not (number.is_integer() and 0 <= number <= MAX_RUN):
        raise ResultsError(f"{place}: run: got {shown(text)}; allowed: an integer from 0 to {MAX_RUN}")
    return int(number)


def _x(place: str, text: str) -> float:
    number = _number(place, "x", text)
    if number < 0:
        raise ResultsError(f"{place}: x: got {shown(text)}; allowed: >= 0")
    return number


def _number(place: str, column: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ResultsError(f"{place}: {column}: got {shown(text)}; allowed: a finite number")
    return number


def _ordered(values: dict[float, float]) -> tuple[Floats, Floats]:
    x = np.array(sorted(values))
    return x, np.array([values[each] for each in x.tolist()])
