"""Logs in CSV files: the monitor and the logger of Stable-Baselines3, and exports of Weights & Biases."""

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from bojax.report.comparing.logs.log import Columns, Logged, as_number, logged
from bojax.report.statistics import Floats
from bojax.results.store import ResultsError

PROGRESS_STEPS = "time/total_timesteps"  # column of Stable-Baselines3's `progress.csv`
MONITOR = ("r", "l", "t")  # return, length in steps, and seconds since the start of an episode
_INTERNAL = ("_step", "_runtime", "_timestamp")  # columns that Weights & Biases adds


@dataclass(frozen=True)
class TextTable:
    """A CSV file as text, with the number of the line of each row."""

    path: Path
    header: Sequence[str]
    rows: Sequence[tuple[int, Sequence[str]]]

    def column(self, place: int) -> Floats:
        """The numbers of a column, `[rows]`; NaN in empty cells and beyond the end of a row."""
        name = self.header[place]
        cells = [(line, row[place] if place < len(row) else "") for line, row in self.rows]
        return np.array([as_number(cell, f"{self.path}: line {line}: {name}") for line, cell in cells])


def table_of(path: Path, text: str, *, first_line: int = 1) -> TextTable:
    """Split CSV with at least one row into cells."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        header = [name.strip() for name in next(reader, [])]
        rows = [(reader.line_num + first_line - 1, row) for row in reader if row]
    except csv.Error as error:
        raise ResultsError(f"{path}: cannot be read ({error}); allowed: CSV") from None
    if not rows:
        raise ResultsError(f"{path}: has no rows; allowed: at least one below the header")
    return TextTable(path, header, rows)


def is_bare_monitor(text: str) -> bool:
    """Whether a text has the columns of a file of `Monitor`, but not the comment above them."""
    header = [name.strip() for name in text.partition("\n")[0].split(",")]
    return all(name in header for name in MONITOR)


def monitor_columns(texts: Sequence[tuple[Path, str]]) -> Columns:
    """The columns of the files of a folder, as `stable_baselines3.common.monitor.load_results` reads them.

    The files come from parallel environments of one run: their episodes are put in the order in which they
    ended, and their lengths add up to steps. Columns of text are left out.
    """
    tables = [(table_of(path, text.partition("\n")[2], first_line=2), text) for path, text in texts]
    starts = [_start(table.path, text) for table, text in tables]
    shared = [name for name in tables[0][0].header if all(name in table.header for table, _ in tables)]
    for table, _ in tables:
        if missing := [name for name in MONITOR if name not in table.header]:
            raise ResultsError(
                f"{table.path}: no column {missing[0]}; allowed: {', '.join(MONITOR)} and others"
            )
        for (line, _), length in zip(table.rows, table.column(table.header.index("l")), strict=True):
            if length < 0:
                raise ResultsError(f"{table.path}: line {line}: l: got {length:g}; allowed: a length >= 0")

    def all_of(name: str) -> Floats:
        return np.concatenate([table.column(table.header.index(name)) for table, _ in tables])

    def read(name: str) -> Logged:
        begins = np.repeat(starts, [len(table.rows) for table, _ in tables])
        order = np.argsort(begins + all_of("t"), kind="stable") if len(tables) > 1 else slice(None)
        steps, values = np.cumsum(all_of("l")[order]), all_of(name)[order]
        return logged(f"{tables[0][0].path}: {name}", steps, values, is_episodic=True)

    return {name: partial(read, name) for name in shared if name != "t"}


def _start(path: Path, text: str) -> float:
    """The time at which an environment was made, in seconds."""
    try:
        return float(json.loads(text.partition("\n")[0][1:])["t_start"])
    except (ValueError, KeyError, TypeError):
        raise ResultsError(f"{path}: line 1: allowed: # and JSON with t_start, as Monitor writes") from None


def progress_columns(table: TextTable) -> Columns:
    """The columns of `progress.csv`. Rows without a value in a column do not belong to it."""
    place_of_steps = table.header.index(PROGRESS_STEPS)

    def read(place: int) -> Logged:
        values = table.column(place)
        return logged(f"{table.path}: {table.header[place]}", table.column(place_of_steps), values)

    return {
        name: partial(read, place)
        for place, name in enumerate(table.header)
        if place != place_of_steps and name
    }


def is_wandb(header: Sequence[str]) -> bool:
    """Whether a header is one of a chart that Weights & Biases exports: `"Step", "RUN - METRIC", ...`."""
    return len(header) > 1 and all(" - " in name for name in header[1:])


def wandb_runs(table: TextTable) -> list[tuple[str, Columns]]:
    """The names and columns of the runs of an export of Weights & Biases.

    Columns that end in `__MIN` and `__MAX` are bounds of a column within its interval of steps, and are left
    out, as are empty cells.
    """
    runs: list[tuple[str, dict[str, Callable[[], Logged]]]] = []

    def read(place: int) -> Logged:
        return logged(f"{table.path}: {table.header[place]}", table.column(0), table.column(place))

    for place, title in enumerate(table.header[1:], start=1):
        run, _, metric = title.removeprefix("Group: ").rpartition(" - ")
        if metric.endswith(("__MIN", "__MAX")) or metric in _INTERNAL:
            continue
        # Runs may share a name: a column that occurs again belongs to another run.
        own = next((columns for name, columns in runs if name == run and metric not in columns), None)
        if own is None:
            runs.append((run, own := {}))
        own[metric] = partial(read, place)
    return [*runs]
