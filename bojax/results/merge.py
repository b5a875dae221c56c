"""Merging: the committed pieces of all chunks become the tables of a results folder."""

import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bojax.results.attempts import AttemptRegistry
from bojax.results.chunk_folder import ChunkFolder
from bojax.results.store import (
    WORK,
    explained,
    fingerprint,
    read_footer,
    read_table,
    write_table,
    write_tables,
)
from bojax.results.tables import count_nans, sort_rows

RUNS, TIMINGS = "runs", "timings"

HELD_ROWS = 1 << 20
"""Number of rows that are collected before the complete ones among them are written."""

_TIMINGS = ("group", "point", "chunk", "segment", "lanes", "active_steps", "seconds")


NOTABLE: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "ignored_samples": lambda number: number > 0,
    "collapses": lambda number: number > 0,
    "outside_actions": lambda number: number > 0,
    "sampled_gradient": lambda slope: slope == 0.0,
}
"""Columns of runs that are counted where they have such a value."""


@dataclass(frozen=True)
class Merged:
    """What merging has found."""

    files: Mapping[int, ChunkFolder]  # the committed files of each chunk that has any, by index of the chunk
    errors: Mapping[int, str]  # why chunks have failed, by index
    nans: Mapping[tuple[int, int], int]  # number of NaNs of each (point, run) that has any
    notable: Mapping[str, int]  # number of runs with a value in `NOTABLE`, by column
    sha256: Mapping[str, str]  # SHA-256 of the tables and of the snapshots, by path in the results folder


def merge(
    folder: Path,
    chunks: Mapping[str, tuple[int, int]],
    names: Iterable[str],
    points: Sequence[Mapping[str, Any]],
    seed: int,
) -> Merged:
    """Write every table from the chunks that are done, and move their snapshots.

    The tables depend only on the rows of the pieces, which are sorted: an interrupted and resumed sweep gives
    the same bytes as an uninterrupted one.

    All chunks of the sweep in order have their group and their point, -1 for several; each of its points has
    its `label`, `variant` and `swept` values.

    Raises:
        ResultsError: A committed file is missing or has changed; in this case nothing is written.
    """
    attempts = AttemptRegistry(folder / WORK, folder)
    files = committed_files(attempts, chunks)
    done = [found for found in files.values() if found.state.is_done]
    # Lists, since every file is verified by this, before the first table is written.
    pieces = {name: [piece for each in done for piece in each.pieces(name)] for name in dict.fromkeys(names)}
    moves = [(each.committed(name), folder / name) for each in done for name in each.snapshots()]
    nans = _write_tables(folder, pieces, points, seed)
    write_table(folder / f"{TIMINGS}.parquet", _timings(chunks, files))
    for source, target in moves:
        if source != target:  # otherwise an earlier merge has moved it
            with explained(target):
                _move(source, target)
    return Merged(
        files=files,
        errors={
            index: attempts.reason(name)
            for index, name in enumerate(chunks)
            if name in attempts.failed and name not in attempts.done
        },
        nans=nans,
        notable={column: _num_runs(folder, column, is_notable) for column, is_notable in NOTABLE.items()},
        sha256=_checksums(folder, [*pieces, TIMINGS], done),
    )


def committed_files(attempts: AttemptRegistry, chunks: Iterable[str]) -> dict[int, ChunkFolder]:
    """The committed files of each chunk that has any, by its index among the names of all chunks."""
    found = {index: attempts.committed(name) for index, name in enumerate(chunks) if attempts.newest(name)}
    return {index: files for index, files in found.items() if files is not None}


def _write_tables(
    folder: Path, pieces: Mapping[str, Sequence[Path]], points: Sequence[Mapping[str, Any]], seed: int
) -> dict[tuple[int, int], int]:
    """Write every table, and return the number of NaNs of each (point, run) that has any."""
    nans: Counter[tuple[int, int]] = Counter()

    def merged(name: str) -> Iterator[pa.Table]:
        for rows in sorted_rows(pieces[name]):
            nans.update(count_nans(rows))
            yield _runs(rows, points, seed, nans) if name == RUNS else _labelled(rows, points)

    for name in sorted(pieces, key=lambda name: name == RUNS):  # last, since it has the NaNs of all tables
        if pieces[name]:
            write_tables(folder / f"{name}.parquet", merged(name))
    return nans


def _timings(chunks: Mapping[str, tuple[int, int]], files: Mapping[int, ChunkFolder]) -> pa.Table:
    """One row per segment."""
    rows = [
        (group, point, index, number, int(lanes), int(steps), float(seconds))
        for index, (group, point) in enumerate(chunks.values())
        if index in files
        for number, (lanes, steps, seconds) in enumerate(files[index].state.segments)
    ]
    return pa.table({name: [row[i] for row in rows] for i, name in enumerate(_TIMINGS)})


def _checksums(folder: Path, tables: Iterable[str], chunks: Iterable[ChunkFolder]) -> dict[str, str]:
    """SHA-256 of the merged tables and of the snapshots, by path in the results folder."""
    found = {f"{name}.parquet": fingerprint(folder / f"{name}.parquet") for name in tables}
    for chunk in chunks:
        found |= {name: chunk.state.files[name] for name in chunk.snapshots()}
    return {name: each["sha256"] for name, each in found.items() if each is not None}


def _num_runs(folder: Path, column: str, is_counted: Callable[[np.ndarray], np.ndarray]) -> int:
    """Number of runs whose value in a column counts; 0 without the column."""
    path = folder / f"{RUNS}.parquet"
    if not path.is_file() or column not in read_footer(path).schema.names:
        return 0
    return int(np.sum(is_counted(read_table(path, [column])[column].to_numpy())))


def sorted_rows(pieces: Sequence[Path]) -> Iterator[pa.Table]:
    """The rows of all pieces of a table in the order of results, in tables that do not overlap.

    Pieces are read in the order of their first rows. Rows that precede the first row of every unread piece
    are complete, so that they can be yielded, once more than `HELD_ROWS` rows have been read.
    """
    schemas: dict[pa.Schema, None] = {}
    order: list[tuple[int, int]] = []
    for index, piece in enumerate(pieces):
        footer = read_footer(piece)
        schemas[footer.schema.to_arrow_schema()] = None
        order.append((_first_run(footer), index))
    order.sort()
    schema = pa.unify_schemas(list(schemas))
    bounds = [start for start, _ in order[1:]] + [None]
    held: list[pa.Table] = []
    count = kept = 0
    lowest = order[0][0] if order else 0  # no row that is held precedes it
    for (_, index), bound in zip(order, bounds, strict=True):
        held.append(read_table(pieces[index]))
        count += held[-1].num_rows
        # Rows that stayed incomplete do not count, or all of them would be looked at again for every piece.
        # Where all pieces of a chunk begin with its first run, none of its rows is complete before the last.
        if bound is not None and (count - kept <= HELD_ROWS or bound <= lowest):
            continue
        rows = pa.concat_tables([schema.empty_table(), *held], promote_options="default")
        if bound is None:
            yield sort_rows(rows)
            return
        is_complete = _keys(rows) < bound
        held = [rows.filter(pa.array(~is_complete))]
        count = kept = held[0].num_rows
        lowest = bound
        if (complete := rows.filter(pa.array(is_complete))).num_rows:
            yield sort_rows(complete)


def _keys(rows: pa.Table) -> np.ndarray:
    """Point and run of each row as one number."""
    return _key(rows["point"].to_numpy().astype(np.int64), rows["run"].to_numpy().astype(np.int64))


def _key(point, run):
    return (point << 32) + run  # runs are int32: these numbers are in the order of results


def _first_run(footer: pq.FileMetaData) -> int:
    """A lower bound of the keys in a piece, from the statistics in its footer."""
    groups = [footer.row_group(index) for index in range(footer.num_row_groups)]
    of_point, of_run = ([group.column(column).statistics for group in groups] for column in (0, 1))
    first, last = min(each.min for each in of_point), max(each.max for each in of_point)
    # Of several points, the least run may not be one of the first point: 0 is then the only safe bound.
    return _key(first, min(each.min for each in of_run) if first == last else 0)


def _move(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    os.replace(source, target)


def _labelled(table: pa.Table, points: Sequence[Mapping[str, Any]]) -> pa.Table:
    return table.add_column(1, "label", _of_point(table, [point["label"] for point in points], pa.string()))


def _runs(table: pa.Table, points: Sequence[Mapping[str, Any]], seed: int, nans: Mapping) -> pa.Table:
    """`point, label, variant, <swept keys>, run, seed, <scalars>, nans`."""
    keys = table["point"].to_pylist(), table["run"].to_pylist()
    columns: dict[str, Any] = {
        "point": table["point"],
        "label": _of_point(table, [point["label"] for point in points], pa.string()),
        "variant": _of_point(table, [point["variant"] for point in points], pa.string()),
    }
    for key in dict.fromkeys(key for point in points for key in point["swept"]):
        values, kind = _column([point["swept"].get(key) for point in points])
        columns[key] = _of_point(table, values, kind)
    columns["run"] = table["run"]
    columns["seed"] = pa.array(np.full(table.num_rows, seed, dtype=np.int64))
    columns |= {name: table[name] for name in table.column_names if name not in ("point", "run")}
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
    given = {type(value) for value in values if value is not None}
    if given in ({bool}, {int}):
        return list(values), pa.bool_() if given == {bool} else pa.int64()
    if given in ({float}, {int, float}):
        return [None if value is None else float(value) for value in values], pa.float64()
    return [
        value if value is None or isinstance(value, str) else json.dumps(value) for value in values
    ], pa.string()
