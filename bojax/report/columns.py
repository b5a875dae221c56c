"""Reads tables and snapshots of a results folder as arrays."""

from collections import UserDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from typing_extensions import override

from bojax.config.errors import did_you_mean
from bojax.results.store import ResultsError, read_table


class NoColumn(ResultsError):
    """A table lacks a column; the message names it."""


class Columns(UserDict[str, Any]):
    """A table as one array per column; a null is NaN in a column of numbers and None elsewhere.

    Columns of Arrow become arrays when they are asked for: a table of 10^8 episodes has columns of text that
    few readers need, and others are needed for some points alone.
    """

    @override
    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self.data:
            raise NoColumn(f"the results have no column {name}{did_you_mean(name, self)}")
        values = self.data[name]
        if not isinstance(values, np.ndarray):
            is_key = name in ("point", "run", "episode", "step")
            values = self.data[name] = (values.cast(pa.int64()) if is_key else values).to_numpy()
        return values

    @override
    def get(self, key: str, default: Any = None) -> Any:
        return self[key] if key in self else default

    def rows(self, parts: Sequence[slice]) -> "Columns":
        """The rows of some slices, one after the other; a single one is a view."""
        return Columns({name: _rows(values, parts) for name, values in self.data.items()})


def _rows(values: NDArray[Any] | pa.ChunkedArray, parts: Sequence[slice]) -> NDArray[Any] | pa.ChunkedArray:
    if isinstance(values, np.ndarray):
        return values[parts[0]] if len(parts) == 1 else np.concatenate([values[part] for part in parts])
    pieces = [values.slice(part.start, part.stop - part.start) for part in parts]
    return pa.chunked_array([each for piece in pieces for each in piece.chunks], values.type)


def read_columns(path: Path) -> Columns:
    """A table of a results folder."""
    table = read_table(path)
    return Columns(dict(zip(table.column_names, table.columns, strict=True)))


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
