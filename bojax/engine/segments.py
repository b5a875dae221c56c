"""Advances issued ahead, so that the device does not wait for the host, and the rows of their records."""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from bojax.engine.batch import Lanes, Programs, Status
from bojax.engine.protocol import VALID
from bojax.experiments.base import Carry
from bojax.results.schema import Table

LOOKAHEAD_SECONDS = 0.02
"""Duration of the work kept in the device's queue, much longer than a round trip to the host. A longer
advance is issued only when the previous one has ended, so that none is wasted after all lanes are done."""

MAX_LOOKAHEAD = 16

Rows = dict[str, np.ndarray]


@dataclass(frozen=True)
class Advances:
    """Consecutive advances of the same lanes.

    Attributes:
        carry: The carry after them.
        records: The tables of each, on the device.
        statuses: The `Status` after each, on the host.
        num_bytes: Size of the records.
    """

    carry: Carry
    records: list[Any]
    statuses: list[Any]
    num_bytes: int


def run_advances(
    programs: Programs,
    carry: Carry,
    lanes: Lanes,
    *,
    most: int,
    most_bytes: int,
    seconds: float,
    stop: Callable[[], bool],
) -> Advances:
    """Advance all lanes until they are done, a limit is reached, or a stop is requested.

    Args:
        programs: The compiled programs.
        carry: The carry to start from; its buffers are donated.
        lanes: Inputs of the lanes.
        most: Maximum number of advances.
        most_bytes: Size of records after which no further advance is issued.
        seconds: Wall time after which no further advance is issued.
        stop: Whether a stop is requested, checked after each advance.
    """
    start = time.perf_counter()
    records: list[Any] = []
    statuses: list[Status] = []
    waiting: deque[Status] = deque()
    lookahead, finished, num_bytes = 0, 0, 0
    while len(records) < most and (num_bytes < most_bytes or not records):
        carry, tables, status = programs.advance(carry, lanes)
        num_bytes += sum(column.nbytes for column in jax.tree.leaves(tables))
        records.append(tables)
        statuses.append(status)
        waiting.append(status)
        if len(waiting) <= lookahead:
            continue
        is_done = np.asarray(waiting.popleft().is_done).all()
        finished += 1
        elapsed = time.perf_counter() - start
        lookahead = min(MAX_LOOKAHEAD, int(LOOKAHEAD_SECONDS * finished / elapsed))
        if is_done or elapsed > seconds or stop():
            break
    return Advances(carry, records, jax.device_get(statuses), num_bytes)


def fetch_rows(
    records: Sequence[Any],
    tables: Mapping[str, Table],
    points: np.ndarray,
    runs: np.ndarray,
    kept: Mapping[str, np.ndarray],
) -> dict[str, Rows]:
    """The valid rows of the records of advances, `{table: {column: [rows]}}`, with the point and run of each.

    Args:
        records: The tables of each advance, columns `[lanes, rows]`.
        tables: Schemas of the tables.
        points: Point of each lane.
        runs: Run of each lane; the rows of lanes without a run, -1, are left out.
        kept: For each table of which only some lanes are kept, those lanes.
    """
    fetched = jax.device_get([_lanes_of(advance, kept) for advance in records])
    rows: dict[str, Rows] = {}
    for name in fetched[0] if fetched else ():
        real = (runs >= 0)[kept[name] if name in kept else slice(None), None]
        found = [np.nonzero(advance[name][VALID] & real) for advance in fetched]
        lanes = np.concatenate([lane for lane, _ in found])
        if name in kept:
            lanes = kept[name][lanes]
        rows[name] = {"point": points[lanes], "run": runs[lanes]} | {
            column.name: np.concatenate(
                [advance[name][column.name][where] for advance, where in zip(fetched, found, strict=True)]
            )
            for column in tables[name]
        }
    return rows


def _lanes_of(tables: Mapping[str, Mapping[str, Array]], kept: Mapping[str, np.ndarray]) -> Any:
    """The tables with the rows of the kept lanes only; other rows never leave the device."""
    return {
        name: {key: column[kept[name]] for key, column in columns.items()} if name in kept else columns
        for name, columns in tables.items()
    }
