"""Reads tables and snapshots of a results folder as arrays."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from bojax.config.errors import did_you_mean
from bojax.results.store import ResultsError, read_table


class NoColumn(ResultsError):
    """A table lacks a column; the message names it."""


class Columns(dict[str, NDArray[Any]]):
    """A table as one array per column; a null is NaN in a column of numbers and None elsewhere."""

    def __missing__(self, name: str) -> NDArray[Any]:
        raise NoColumn(f"the results have no column {name}{did_you_mean(name, self)}")


def read_columns(path: Path) -> Columns:
    """A table of a results folder.

    Raises:
        ResultsError: The file cannot be read.
    """
    columns = Columns()
    for name, values in zip((table := read_table(path)).column_names, table.columns, strict=True):
        is_key = name in ("point", "run", "episode", "step")
        columns[name] = (values.cast(pa.int64()) if is_key else values).to_numpy()
    return columns


def where(columns: Columns, **values: Any) -> Columns:
    """The rows with these values of columns; no row of an empty table."""
    kept = np.logical_and.reduce([columns[name] == value for name, value in values.items() if columns])
    return Columns({key: column[kept] for key, column in columns.items()})


Arrays = Mapping[str, NDArray[Any]]

BELIEF = {"x", "y", "truth", "mean", "std"}
"""Arrays of a `belief` snapshot of a field; snapshots without them belong to other problems."""


def read_snapshot(path: Path, name: str) -> Arrays:
    """The arrays of a snapshot."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
    except Exception as error:  # damaged archives raise many kinds of exceptions
        raise ResultsError(f"{path}: cannot be read: was it truncated?") from error
    if name == "paths" and "paths" not in arrays:  # of a user's problem, which may use the name otherwise
        raise ResultsError(f"{path}: no array paths: not a snapshot of bojax")
    return arrays
