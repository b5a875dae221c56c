"""Reads tables and snapshots of a results folder as arrays, and checks their types, rows and shapes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from bojax.results.store import ResultsError, read_table


class NoColumn(ResultsError):
    """A table lacks a column; the message names it."""


class Columns(dict[str, NDArray[Any]]):
    """A table as one array per column; a null is NaN in a column of numbers and None elsewhere."""

    def __missing__(self, name: str) -> NDArray[Any]:
        raise NoColumn(f"the results have no column {name}")


KEYS: Mapping[str, tuple[str, ...]] = {
    "runs": ("point", "run"),
    "steps": ("point", "run", "step"),
    "episodes": ("point", "run", "episode"),
}
"""Columns that identify a row of each table. Steps of a learner also have an `episode`."""

_TYPES = {
    "integers": (pa.types.is_integer,),
    "text": (pa.types.is_string, pa.types.is_large_string),
    "true or false": (pa.types.is_boolean,),
    "numbers": (pa.types.is_integer, pa.types.is_boolean, pa.types.is_floating),
}
_BOOLEANS = ("success", "reached", "terminated", "truncated", "done")
_NUMBERS = (
    *("return", "steps", "exits", "nans", "rmse", "wrmse", "mnll", "collisions", "sampled_gradient"),
    *("wrmse_gradient", "wrmse_value"),
    *("episodes", "outside", "episodes_to_goal", "steps_to_goal", "episodes_to_target"),
    *("return_after_target", "planned_return", "length", "kappa", "trajectories"),
    *("reward", "planned_reward", "accumulated_reward", "x", "y", "heading"),
)
_KNOWN = {"phase": "text", **dict.fromkeys(_BOOLEANS, "true or false"), **dict.fromkeys(_NUMBERS, "numbers")}
_NUMBERED = ("observation_", "action_", "qpos_")


def read_columns(folder: Path, name: str, points: Sequence[int]) -> Columns:
    """A table of a results folder, whose manifest has points of these indices.

    Raises:
        ResultsError: The file cannot be read, a column has the wrong type, a row belongs to an unknown point
            or run, or rows are missing or duplicated.
    """
    path = folder / f"{name}.parquet"
    table = read_table(path)
    keys = list(KEYS[name])
    if name == "steps" and "episode" in table.column_names:
        keys.insert(2, "episode")
    for column in (*keys, *(["phase"] if name == "episodes" else [])):
        if column not in table.column_names:
            raise ResultsError(f"{path}: no column {column}: not a table of bojax")
    if len(set(table.column_names)) < len(table.column_names):
        raise ResultsError(f"{path}: two columns have the same name")
    columns = Columns()
    for column, values in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_dictionary(values.type):
            values = values.cast(values.type.value_type)
        _check_type(path, column, values, is_key=column in keys)
        try:
            columns[column] = (values.cast(pa.int64()) if column in keys else values).to_numpy()
        except (pa.ArrowException, NotImplementedError, ValueError) as error:
            raise ResultsError(f"{path}: {column}: a column of {values.type} cannot be read") from error
    order = np.lexsort([columns[key] for key in reversed(keys)])
    if (np.diff(order) != 1).any():  # bojax writes rows in the order of their keys
        columns = Columns({column: values[order] for column, values in columns.items()})
    unknown = np.setdiff1d(columns["point"], points)
    if unknown.size:
        raise ResultsError(f"{path}: point: got {unknown[0]}, which the manifest does not have")
    if name == "episodes":
        _check_phases(path, columns, keys)
    else:
        _check_rows(path, columns, keys)
    return columns


def where(columns: Columns, **values: Any) -> Columns:
    """The rows with these values of columns; an empty table has none."""
    kept = np.logical_and.reduce([columns[name] == value for name, value in values.items() if columns])
    return Columns({key: column[kept] for key, column in columns.items()})


def check_runs(folder: Path, name: str, columns: Columns, runs: Columns) -> None:
    """Refuse rows whose run is missing from `runs.parquet`."""
    known, used = (np.unique(table["point"] << 32 | table["run"]) for table in (runs, columns))
    stray = np.setdiff1d(used, known, assume_unique=True)
    if stray.size:
        point, run = int(stray[0]) >> 32, int(stray[0]) & (2**32 - 1)
        raise ResultsError(f"{folder / name}.parquet: run: point {point} has no run {run} in runs.parquet")


def _check_type(path: Path, column: str, values: pa.ChunkedArray, *, is_key: bool) -> None:
    numbered = "numbers" if column.startswith(_NUMBERED) else None
    wanted = "integers" if is_key else _KNOWN.get(column, numbered)
    if wanted and not any(is_type(values.type) for is_type in _TYPES[wanted]):
        raise ResultsError(f"{path}: {column}: got a column of {values.type}; allowed: {wanted}")
    if values.null_count and wanted not in (None, "numbers"):
        raise ResultsError(f"{path}: {column}: got {values.null_count} nulls; allowed: none")


def _check_phases(path: Path, columns: Columns, keys: Sequence[str]) -> None:
    """Training episodes are numbered without a gap; tests have the number of the episode before them."""
    is_training = columns["phase"] == "train"
    if not (is_training | (columns["phase"] == "test")).all():
        raise ResultsError(f"{path}: phase: allowed: train, test")
    _check_rows(path, Columns({key: columns[key][is_training] for key in keys}), keys)
    most = columns["episode"][is_training].max(initial=0)
    if columns["episode"].max(initial=0) > most or columns["episode"].min(initial=1) < 1:
        raise ResultsError(f"{path}: episode: allowed in a test: 1 to {most}, those of training")


def _check_rows(path: Path, columns: Columns, keys: Sequence[str]) -> None:
    """Rows are unique; steps and episodes are numbered from 1 without a gap."""
    run, above, number = columns["run"], keys[:-1], columns[keys[-1]]
    if not run.size:
        return
    if run.min() < 0 or run.max() >= 2**31:
        raise ResultsError(f"{path}: run: allowed: 0 to {2**31 - 1}")
    is_same = np.logical_and.reduce([columns[key][1:] == columns[key][:-1] for key in above])
    is_twin = np.concatenate([[False], is_same & (number[1:] == number[:-1])])
    if is_twin.any():
        raise ResultsError(f"{path}: two rows for {_told(columns, keys, is_twin)}; allowed: one")
    expected = np.concatenate([[1], np.where(is_same, number[:-1] + 1, 1)])
    is_wrong = number != expected
    if keys[-1] != "run" and is_wrong.any():
        raise ResultsError(
            f"{path}: {keys[-1]}: got {number[is_wrong][0]} of {_told(columns, above, is_wrong)}, where "
            f"{expected[is_wrong][0]} is expected"
        )


def _told(columns: Columns, keys: Sequence[str], where: NDArray[np.bool_]) -> str:
    """The keys of the first row that a mask selects, in words."""
    return ", ".join(f"{key} {columns[key][where][0]}" for key in keys)


Arrays = Mapping[str, NDArray[Any]]

SHAPES: Mapping[str, Mapping[str, str]] = {
    "paths": {"paths": "T S 3", "plans": "T S 3", "start": "3", "frames": "T F Q"},
    "belief": {
        **{"x": "X", "y": "Y", "truth": "Y X", "mean": "Y X", "std": "Y X"},
        **{"samples": "N 3", "means": "U V W", "stds": "U V W"},
    },
    "values": {"episodes": "K", "maps": "K 2 ...", "low": "D", "high": "D"},
    "trajectories": {"paths": "K S 3"},
}
"""Shapes of arrays by name of the snapshot. A letter is a size that the arrays of one file share."""


BELIEF = {"x", "y", "truth", "mean", "std"}
"""Arrays of a `belief` snapshot of a field; snapshots without them belong to other problems."""


def read_snapshot(path: Path, name: str) -> Arrays:
    """The arrays of a snapshot."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
    except Exception as error:  # damaged archives raise many kinds of exceptions
        raise ResultsError(f"{path}: cannot be read: was it truncated?") from error
    if name == "paths" and "paths" not in arrays:
        raise ResultsError(f"{path}: no array paths: not a snapshot of bojax")
    if name == "belief" and not BELIEF <= arrays.keys():
        return arrays  # of a user's problem, which may use the names otherwise
    sizes: dict[str, int] = {}
    for key, shape in SHAPES.get(name, {}).items():
        if key in arrays:
            _check(arrays[key], shape, sizes, f"{path}: {key}")
    return arrays


def _check(array: NDArray[Any], shape: str, sizes: dict[str, int], where: str) -> None:
    if array.dtype.kind not in "biuf":
        raise ResultsError(f"{where}: got values of type {array.dtype}; allowed: numbers")
    axes = shape.removesuffix(" ...").split()
    is_open = shape.endswith("...")
    known = {axis: int(axis) for axis in axes if axis.isdigit()} | sizes
    fits = array.ndim > len(axes) if is_open else array.ndim == len(axes)
    if not fits or any(known.setdefault(*pair) != pair[1] for pair in zip(axes, array.shape, strict=False)):
        wanted = ", ".join(str(sizes.get(axis, axis)) for axis in axes) + (", ..." if is_open else "")
        raise ResultsError(f"{where}: got the shape {list(array.shape)}; allowed: [{wanted}]")
    sizes.update(known)
