"""Curves of other libraries from CSV files: one row per value, checked with one-line errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pydantic
from pydantic import Field

from bojax.config.errors import ConfigError, allowed_names, dotted, from_validation, shown
from bojax.config.limits import TEXT, read_within
from bojax.report.comparing.logs.text_tables import table_of
from bojax.report.statistics import Floats
from bojax.results.store import ResultsError

COLUMNS = ("label", "run", "x", "value")  # columns that a file must have
TASK = "task"  # column that a file may have


class _Row(pydantic.BaseModel):
    label: Annotated[str, Field(min_length=1)]
    task: Annotated[str, Field(min_length=1)] = ""
    run: Annotated[int, Field(ge=0, lt=2**31)]
    x: Annotated[pydantic.FiniteFloat, Field(ge=0, le=2**53)]  # beyond, two steps can be one number
    value: Annotated[pydantic.FiniteFloat, Field(ge=-1e75, le=1e75)]  # fourth powers are finite


@dataclass(frozen=True)
class Rows:
    """The rows of a label."""

    label: str
    task: str  # empty if the file has no such column
    runs: dict[int, tuple[Floats, Floats]]  # x, ascending, and value of each run
    has_curve: bool = True  # False of scores, one value per run
    column: str = ""  # the column of a log that the values are from


def read_curves(path: Path) -> list[Rows]:
    """Read a CSV file with the columns `label, run, x, value` and optionally `task`, in any order.

    Rows differ in label, task, run or x, in any order; labels are listed in the order of their first rows.
    """
    text = text_of(path)
    if not text.strip():
        raise ResultsError(f"{path}: is empty; allowed: the columns {', '.join(COLUMNS)} and rows")
    table = table_of(path, text)
    header = table.header
    _check_header(path, header)
    cells: dict[tuple[str, str], dict[int, dict[float, float]]] = {}
    for line, texts in table.rows:
        place = f"{path}: line {line}"
        if len(texts) != len(header):
            raise ResultsError(f"{place}: got {len(texts)} cells; allowed: {len(header)}, as in the header")
        try:
            row = _Row.model_validate(dict(zip(header, map(str.strip, texts), strict=True)))
        except pydantic.ValidationError as error:
            told = from_validation(error, lambda at, place=place: f"{place}: {dotted(at)}")
            raise ResultsError(str(told)) from error
        values = cells.setdefault((row.label, row.task), {}).setdefault(row.run, {})
        if row.x in values:
            raise ResultsError(
                f"{place}: x: got {row.x:g} of run {row.run} of {row.label} twice; allowed: once"
            )
        values[row.x] = row.value
    return [
        Rows(label, task, {run: tuple(np.array(sorted(runs[run].items())).T) for run in sorted(runs)})
        for (label, task), runs in cells.items()
    ]


def text_of(path: Path) -> str:
    """The content of a file in UTF-8."""
    try:
        return read_within(TEXT, path, str(path)).decode("utf-8-sig")
    except ConfigError:
        raise
    except UnicodeDecodeError:
        raise ResultsError(f"{path}: cannot be read; allowed: CSV in UTF-8") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ResultsError(f"{path}: cannot be read: {reason}") from None


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
