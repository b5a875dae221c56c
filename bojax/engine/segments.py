"""Segments: advances grouped by wall time and issued ahead, so that the device never waits for the host."""

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from bojax.engine.batch import Compiled, Lanes, Status
from bojax.engine.protocol import VALID
from bojax.engine.signals import StopRequest
from bojax.experiments.base import Carry
from bojax.results.schema import Table

LOOKAHEAD_SECONDS = 0.02
"""Duration of the work kept in the device's queue, much longer than a round trip to the host. A longer
advance is issued only when the previous one has ended, so that none is wasted after all lanes are done."""

MAX_LOOKAHEAD = 16
MAX_ADVANCES = 512
MAX_RECORD_BYTES = 1 << 28
"""Limits of a segment: its advances, and the bytes of their records, which stay on the device meanwhile."""

Rows = dict[str, np.ndarray]


@dataclass(frozen=True)
class Segment:
    """The result of a segment.

    Attributes:
        carry: The carry after the segment.
        records: The tables of each advance, on the device.
        advances: Number of advances.
        remaining: Number of real lanes that are not done.
        active_steps: Number of environment steps of all lanes.
        lane_advances: Number of (lane, advance) pairs in which the lane was active.
        seconds: Wall time of the advances.
    """

    carry: Carry
    records: list[Any]
    advances: int
    remaining: int
    active_steps: int
    lane_advances: int
    seconds: float


def run_segment(
    program: Compiled,
    carry: Carry,
    lanes: Lanes,
    remaining: int,
    seconds: float,
    max_advances: int,
    stop: StopRequest,
) -> Segment:
    """Advance all lanes until they are done, the time is up, or a stop is requested.

    Args:
        program: The compiled group.
        carry: The carry to start from; its buffers are donated.
        lanes: Inputs of the lanes.
        remaining: Number of real lanes that are not done at the start.
        seconds: Wall time after which no further advance is issued.
        max_advances: Maximum number of advances.
        stop: Request to stop, checked after each advance.
    """
    start = time.perf_counter()
    records: list[Any] = []
    statuses: list[Status] = []
    waiting: deque[Status] = deque()
    lookahead, finished = 0, 0
    limit = min(max_advances, MAX_ADVANCES)
    while len(records) < limit:
        carry, tables, status = program.advance(carry, lanes)
        if not records:
            num_bytes = sum(column.nbytes for column in jax.tree.leaves(tables))
            limit = min(limit, max(1, MAX_RECORD_BYTES // max(1, num_bytes)))
        records.append(tables)
        statuses.append(status)
        waiting.append(status)
        if len(waiting) <= lookahead:
            continue
        is_done = not np.asarray(waiting.popleft().remaining).any()
        finished += 1
        elapsed = time.perf_counter() - start
        lookahead = min(MAX_LOOKAHEAD, int(LOOKAHEAD_SECONDS * finished / elapsed))
        if is_done or elapsed > seconds or stop:
            break
    jax.block_until_ready(carry)
    elapsed = time.perf_counter() - start
    fetched = jax.device_get(statuses)
    left = [int(status.remaining.sum()) for status in fetched]
    return Segment(
        carry=carry,
        records=records,
        advances=len(records),
        remaining=left[-1],
        active_steps=sum(int(status.active_steps.sum()) for status in fetched),
        lane_advances=remaining + sum(left[:-1]),
        seconds=elapsed,
    )


def fetch_rows(
    records: Sequence[Any],
    tables: Mapping[str, Table],
    points: np.ndarray,
    runs: np.ndarray,
    kept: Mapping[str, np.ndarray],
) -> dict[str, Rows]:
    """The valid rows of a segment's records, `{table: {column: [rows]}}`, with the point and run of each.

    Args:
        records: The tables of each advance, columns `[lanes, rows]`.
        tables: Schemas of the tables.
        points: Point of each real lane; the padding after them has no valid rows.
        runs: Run of each real lane.
        kept: For each table of which only some lanes are kept, those lanes.
    """
    fetched = jax.device_get([_lanes_of(advance, kept) for advance in records])
    rows: dict[str, Rows] = {}
    for name in fetched[0] if fetched else ():
        found = [np.nonzero(advance[name][VALID]) for advance in fetched]
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
