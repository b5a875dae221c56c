"""Merging of the parts of all chunks into the tables of a results folder."""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from bojax.results.parts import ChunkFolder
from bojax.results.store import explained, write_table
from bojax.results.tables import count_nans, sort_rows

RUNS = "runs"


@dataclass(frozen=True)
class PointInfo:
    """The columns of the merged tables that describe a point: label, variant and swept values."""

    index: int
    label: str
    variant: str
    swept: Mapping[str, Any]


def merge(
    folder: Path, chunks: Sequence[ChunkFolder], names: Iterable[str], points: Sequence[PointInfo], seed: int
) -> dict[tuple[int, int], int]:
    """Write every table, move snapshots and learners, and return the NaN counts `{(point, run): count}`.

    The tables depend on nothing but the rows of the parts, which are sorted, so that an interrupted and
    resumed sweep gives the same bytes as an uninterrupted one.

    Raises:
        ResultsError: A committed file is missing or has changed; in this case nothing is written.
    """
    tables: dict[str, pa.Table] = {}
    for name in names:
        parts = [table for chunk in chunks for table in chunk.tables(name)]
        if parts:
            tables[name] = sort_rows(pa.concat_tables(parts, promote_options="default"))
    moves = [(chunk.committed(name), folder / name) for chunk in chunks for name in chunk.saved()]
    nans = count_nans(list(tables.values()))
    for name, table in tables.items():
        merged = _runs(table, points, seed, nans) if name == RUNS else _labelled(table, points)
        write_table(folder / f"{name}.parquet", merged)
    for source, target in moves:
        if source != target:  # otherwise an earlier merge has moved it
            with explained(target):
                _move(source, target)
    return nans


def _move(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    os.replace(source, target)


def _labelled(table: pa.Table, points: Sequence[PointInfo]) -> pa.Table:
    return table.add_column(1, "label", _of_point(table, [point.label for point in points], pa.string()))


def _runs(table: pa.Table, points: Sequence[PointInfo], seed: int, nans: Mapping) -> pa.Table:
    """`point, label, variant, <swept keys>, run, seed, <scalars>, nans`."""
    keys = table["point"].to_pylist(), table["run"].to_pylist()
    columns: dict[str, Any] = {
        "point": table["point"],
        "label": _of_point(table, [point.label for point in points], pa.string()),
        "variant": _of_point(table, [point.variant for point in points], pa.string()),
    }
    for key in dict.fromkeys(key for point in points for key in point.swept):
        values, kind = _column([point.swept.get(key) for point in points])
        columns[key] = _of_point(table, values, kind)
    columns["run"] = table["run"]
    columns["seed"] = pa.array(np.full(table.num_rows, seed, dtype=np.int64))
    scalars = {name: table[name] for name in table.column_names if name not in ("point", "run")}
    columns |= scalars
    columns["nans"] = pa.array([nans.get(key, 0) for key in zip(*keys, strict=True)], pa.int64())
    fields = [
        table.schema.field(name) if name in table.column_names else pa.field(name, column.type)
        for name, column in columns.items()
    ]
    return pa.Table.from_arrays(list(columns.values()), schema=pa.schema(fields))


def _of_point(table: pa.Table, values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    return pa.array(values, kind).take(table["point"].combine_chunks())


def _column(values: Sequence[Any]) -> tuple[list[Any], pa.DataType]:
    """Swept values and their Arrow type: Booleans, integers and floats stay, all others become text."""
    given = [value for value in values if value is not None]
    if given and all(isinstance(value, bool) for value in given):
        return list(values), pa.bool_()
    if given and all(isinstance(value, int) and not isinstance(value, bool) for value in given):
        return list(values), pa.int64()
    if given and all(isinstance(value, int | float) and not isinstance(value, bool) for value in given):
        return [None if value is None else float(value) for value in values], pa.float64()
    return [
        value if value is None or isinstance(value, str) else json.dumps(value) for value in values
    ], pa.string()
