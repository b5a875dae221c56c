"""Advances issued ahead, so that the device does not wait for the host, and the rows of their records."""

import time
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

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
    """Consecutive advances of the same lanes."""

    carry: Carry  # the carry after them
    records: list[Any]  # the tables of each, on the device
    statuses: list[Any]  # the `Status` after each, on the host
    num_bytes: int  # size of the records


def run_advances(
    programs: Programs,
    carry: Carry,
    lanes: Lanes,
    recorded: np.ndarray,
    *,
    most: int,
    most_bytes: int,
    seconds: float,
    stop: Callable[[], bool],
) -> Advances:
    """Advance all lanes until they are done, a limit is reached, or a stop is requested.

    The buffers of the carry are donated. After `most_bytes` of records or `seconds`, no further advance is
    issued.
    """
    start = time.perf_counter()
    records: list[Any] = []
    statuses: list[Status] = []
    waiting: deque[Status] = deque()
    lookahead, finished, num_bytes = 0, 0, 0
    while len(records) < most and (num_bytes < most_bytes or not records):
        carry, tables, status = programs.advance(carry, lanes)
        tables = programs.recorded(tables, recorded)  # other rows never leave the device
        num_bytes += sum(column.nbytes for column in jax.tree.leaves(tables))
        records.append(tables)
        statuses.append(status)
        waiting.append(status)
        # The next advance is issued before the result of this one is known, so that the device has work while
        # the host looks. Advances after the last run has ended do nothing and have no valid rows.
        if len(waiting) <= lookahead:
            continue
        is_done = np.asarray(waiting.popleft().is_done).all()  # waits for the oldest advance only
        finished += 1
        elapsed = time.perf_counter() - start
        # As many advances as take `LOOKAHEAD_SECONDS` at the mean pace; none if a single one takes longer.
        lookahead = min(MAX_LOOKAHEAD, int(LOOKAHEAD_SECONDS * finished / elapsed))
        if is_done or elapsed > seconds or stop():
            break
    return Advances(carry, records, jax.device_get(statuses), num_bytes)


def fetch_rows(
    records: Sequence[Any],
    tables: Mapping[str, Table],
    points: np.ndarray,
    runs: np.ndarray,
    recorded: np.ndarray,
    of_recorded: Collection[str],
) -> dict[str, Rows]:
    """The valid rows of the records of advances, `{table: {column: [rows]}}`, with the point and run of each.

    Records are tables with columns `[lanes, rows]`, as from `Programs.recorded`. Lanes without a run, -1, are
    left out; the tables `of_recorded` have rows of recorded runs only.
    """
    fetched = jax.device_get(list(records))  # one call for all advances: the copies overlap
    rows: dict[str, Rows] = {}
    for name in fetched[0] if fetched else ():
        # Columns of recorded runs are padded behind the recorded lanes, see `Programs.recorded`.
        own = recorded if name in of_recorded else np.arange(len(runs))
        real = (runs >= 0)[own, None]
        found = [np.nonzero(advance[name][VALID][: len(own)] & real) for advance in fetched]
        lanes = own[np.concatenate([lane for lane, _ in found])]
        rows[name] = {"point": points[lanes], "run": runs[lanes]} | {
            column.name: np.concatenate(
                [advance[name][column.name][where] for advance, where in zip(fetched, found, strict=True)]
            )
            for column in tables[name]
        }
    return rows
