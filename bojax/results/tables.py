"""Conversion of NumPy columns to Arrow tables, the order of rows, and counts of NaN."""

from collections import Counter
from collections.abc import Mapping

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from bojax.results.schema import Column, Table

SORT_KEYS = ("point", "run", "episode", "step")
"""Sort keys of merged tables; a table is sorted by those that it has."""

KEYS: Table = (
    Column("point", "int32", doc="index of the point of the sweep"),
    Column("run", "int32", doc="index of the run"),
)
"""The first columns of every table, which identify the run of a row."""


def to_arrow(table: Table, columns: Mapping[str, np.ndarray]) -> pa.Table:
    """Columns as an Arrow table. In a nullable column, -1 and NaN become null; indices become words."""
    schema, arrays = pa.schema([_field(column) for column in table]), []
    for column, field in zip(table, schema, strict=True):
        values = np.asarray(columns[column.name])
        if column.words:
            arrays.append(pa.array(column.words, field.type).take(pa.array(values)))
            continue
        null = np.isnan(values) if values.dtype.kind == "f" else values == -1
        arrays.append(pa.array(values, mask=null if column.nullable else None).cast(field.type))
    return pa.Table.from_arrays(arrays, schema=schema)


def sort_rows(table: pa.Table) -> pa.Table:
    """The rows in the order of all results files."""
    keys = [(name, "ascending") for name in SORT_KEYS if name in table.column_names]
    return table.combine_chunks().sort_by(keys) if keys else table  # chunks take 1.5 times as long to sort


def count_nans(table: pa.Table) -> Counter[tuple[int, int]]:
    """Number of NaNs of each run, `{(point, run): count}`, over all float columns of a table."""
    counts: Counter[tuple[int, int]] = Counter()
    is_nan = np.zeros(table.num_rows, dtype=np.int64)
    for field in table.schema:
        if pa.types.is_floating(field.type):
            nan = pc.call_function("is_nan", [table[field.name]])
            is_nan += nan.fill_null(False).to_numpy().astype(np.int64)
    (rows,) = np.nonzero(is_nan)
    points, runs = table["point"].to_numpy()[rows], table["run"].to_numpy()[rows]
    for point, run, count in zip(points.tolist(), runs.tolist(), is_nan[rows].tolist(), strict=True):
        counts[point, run] += count
    return counts


def _field(column: Column) -> pa.Field:
    """The Arrow field of a column, with its unit and meaning as metadata."""
    metadata = {key: value for key, value in (("unit", column.unit), ("doc", column.doc)) if value}
    return pa.field(column.name, pa.type_for_alias(column.dtype), metadata=metadata or None)
