"""Runs a chunk on one device: its queue passes through the lanes, and its rows go to a sink.

The chunk pauses after every segment of a few seconds, to write rows and to save checkpoints. Pauses do not
change the results: when runs leave and enter lanes depends on the number of advances alone.
"""

import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from bojax.engine.batch import Lanes, Programs
from bojax.engine.chunks import Chunk
from bojax.engine.errors import EngineError, Stopped
from bojax.engine.segments import Rows, fetch_rows, run_advances
from bojax.engine.storage import Sink
from bojax.errors import FAILURE
from bojax.experiments.base import Experiment
from bojax.results.store import ResultsError
from bojax.results.tables import KEYS, to_arrow

EMPTY = -1
"""In a map from lanes to the runs of a queue: a lane without a run."""

SOON = 2
"""Runs left for each of a smaller number of lanes when the programs for these lanes are compiled."""

MOST_ADVANCES = 512
MOST_RECORD_BYTES = 1 << 28
"""Limits of a segment: its advances, and the bytes of their records, which stay on the device meanwhile."""


@dataclass(frozen=True)
class Segment:
    """What a segment did."""

    finished: int  # number of runs that finished
    active_steps: int  # number of environment steps
    issued_steps: int  # number of steps if all lanes had always been busy
    seconds: float  # wall time, without waiting for a program


@dataclass(frozen=True)
class Limits:
    """When a chunk pauses."""

    segment_seconds: float  # wall time of a segment
    checkpoint_seconds: float  # minimum time between two checkpoints
    # Whether a stop is requested; checked after every advance. By default it never is
    stop: Callable[[], bool] = bool


class ChunkRunner:
    """The state of a chunk while it runs.

    `programs` gives those for one of the chunk's numbers of lanes, and may wait for them. The sink also holds
    the state from which the chunk is resumed. `report` is called after every segment, `announce` with a
    smaller number of lanes once the runs may soon fit into it.
    """

    def __init__(
        self,
        chunk: Chunk,
        experiment: Experiment,
        programs: Callable[[int], Programs],
        sink: Sink,
        limits: Limits,
        report: Callable[[Segment], None],
        announce: Callable[[int], None] = lambda width: None,
    ):
        self._chunk, self._experiment, self._sink = chunk, experiment, sink
        self._programs_of, self._limits, self._report = programs, limits, report
        self._announce = announce
        self._state = sink.state
        self._waited = 0.0  # seconds of waiting for programs, in a segment
        self._summaries: list[Rows] = []
        self._rounds: list[tuple[np.ndarray, np.ndarray, list[Any]]] = []

    def advance(self) -> None:
        """Advance all runs to their ends, or to a checkpoint if a stop is requested.

        The rows of the last segment are left to `finish`, which does not need the device.
        """
        try:
            self._advance()
        except BaseException:
            with contextlib.suppress(ResultsError):
                self._sink.wait()  # nothing is written once the chunk is given back
            raise
        self._carry = None  # frees the device's memory before the last rows are written

    def _advance(self) -> None:
        self._start()
        saved = time.monotonic()
        while self._is_unfinished and not self._limits.stop():
            segment = self._segment()
            if self._is_unfinished:
                self._write()
            self._report(segment)
            is_due = time.monotonic() - saved >= self._limits.checkpoint_seconds
            if self._is_unfinished and (self._limits.stop() or is_due):
                self._sink.save(self._carry)
                saved = time.monotonic()

    def finish(self) -> None:
        """Write the remaining rows and mark the chunk as done; of a paused chunk, wait for its checkpoint."""
        if self._is_unfinished:
            self._sink.wait()
            return
        if self._rounds:
            self._write()
        self._sink.finish()

    @property
    def _is_unfinished(self) -> bool:
        return any(run != EMPTY for run in self._state.lanes)

    @property
    def _map(self) -> np.ndarray:
        """The run of the queue in each lane."""
        return np.asarray(self._state.lanes, dtype=np.int64)

    def _start(self) -> None:
        state, chunk = self._state, self._chunk
        if state.checkpoint is None:
            self._programs = self._programs_of(chunk.layout.lanes)
            count = min(chunk.layout.lanes, chunk.num_runs)
            state.lanes = [*range(count), *[EMPTY] * (chunk.layout.lanes - count)]
            state.started, state.next_run = [0] * chunk.layout.lanes, count
            self._carry = self._programs.init(self._place())
        else:
            self._programs = self._programs_of(len(state.lanes))
            self._place()
            self._carry = self._sink.load(self._programs.carry_structure)
            if self._may_repack and state.next_run == chunk.num_runs:
                self._narrow()  # which a stop may have prevented

    def _place(self) -> Lanes:
        """Put the inputs of the lanes on the device. A lane without a run repeats one that has a run."""
        lanes = self._map
        lanes = np.where(lanes == EMPTY, lanes.max(), lanes)
        self._lanes = self._programs.place(self._chunk.positions[lanes], self._chunk.runs[lanes])
        return self._lanes

    def _segment(self) -> Segment:
        """Advance the lanes for some seconds."""
        state, repack = self._state, self._chunk.layout.repack
        start, first_advance, self._waited = time.perf_counter(), state.advances, 0.0
        finished = active_steps = issued_steps = num_bytes = 0
        while True:
            left = self._limits.segment_seconds - (time.perf_counter() - start - self._waited)
            most = MOST_ADVANCES - (state.advances - first_advance)
            lanes = self._map
            runs = np.where(lanes == EMPTY, EMPTY, self._chunk.runs[lanes])
            recorded = np.nonzero((runs != EMPTY) & (runs < self._sink.recorded_runs))[0]
            made = run_advances(
                self._programs,
                self._carry,
                self._lanes,
                recorded,
                # Not beyond the next repacking: when it takes place depends on the number of advances alone.
                most=min(most, repack - state.advances % repack) if repack else most,
                most_bytes=MOST_RECORD_BYTES - num_bytes,
                seconds=left,
                stop=self._limits.stop,
            )
            self._carry = made.carry
            state.advances += len(made.records)
            num_bytes += made.num_bytes
            self._rounds.append((lanes, recorded, made.records))
            for status in made.statuses:
                steps = np.where(lanes == EMPTY, 0, status.active_steps)
                active_steps += int(steps.sum())
                issued_steps += int(steps.max()) * len(lanes)  # every lane takes as long as the longest
            is_done = made.statuses[-1].is_done
            self._check_end(is_done)
            finished += self._repack(is_done)
            is_full = num_bytes >= MOST_RECORD_BYTES or state.advances - first_advance >= MOST_ADVANCES
            is_late = time.perf_counter() - start - self._waited > self._limits.segment_seconds
            if is_full or is_late or self._limits.stop() or not self._is_unfinished:
                break
        jax.block_until_ready(self._carry)
        seconds = time.perf_counter() - start - self._waited
        state.segments.append([len(state.lanes), active_steps, seconds])
        return Segment(finished, active_steps, issued_steps, seconds)

    def _check_end(self, is_done: np.ndarray) -> None:
        """Raise if a run should have ended."""
        state, most = self._state, self._experiment.max_advances
        late = (self._map != EMPTY) & ~is_done & (state.advances - np.asarray(state.started) >= most)
        if late.any():
            raise EngineError(f"{late.sum()} runs are not done after {most} advances", FAILURE)

    def _repack(self, is_done: np.ndarray) -> int:
        """Let finished runs leave their lanes if it is time to, and return their number.

        The next runs of the queue take their lanes. Once none waits, the unfinished runs move to the smallest
        number of lanes that is enough for them.
        """
        state, lanes = self._state, self._map
        done = np.nonzero((lanes != EMPTY) & is_done)[0]
        live = np.nonzero((lanes != EMPTY) & ~is_done)[0]
        num_waiting = self._chunk.num_runs - state.next_run
        if not len(live) and not num_waiting:
            self._hand_in(done)
            return len(done)
        smaller = [width for width in self._chunk.layout.widths if width < len(lanes)]
        if smaller and len(live) + num_waiting <= SOON * smaller[0]:
            self._announce(smaller[0])
        if not self._may_repack:
            return 0
        # Finished runs keep their lanes, where advances do not change them, until another run can take a lane
        # or fewer lanes are enough: handing them in waits for the device.
        can_move = len(done) if num_waiting else self._fitting(len(live)) < len(lanes)
        if not can_move:
            return 0
        if len(done):
            self._hand_in(done)
            self._refill(done[:num_waiting])
        if state.next_run == self._chunk.num_runs:
            self._narrow()
        return len(done)

    @property
    def _may_repack(self) -> bool:
        """Whether runs may leave and enter lanes after this number of advances."""
        repack = self._chunk.layout.repack
        return repack > 0 and self._state.advances % repack == 0

    def _fitting(self, num_runs: int) -> int:
        """The smallest number of lanes that is enough for some runs."""
        return min(width for width in self._chunk.layout.widths if num_runs <= width)

    def _refill(self, free: np.ndarray) -> None:
        if not len(free):
            return
        state = self._state
        for lane in free.tolist():
            state.lanes[lane], state.started[lane] = state.next_run, state.advances
            state.next_run += 1
        is_new = np.zeros(len(state.lanes), dtype=bool)
        is_new[free] = True
        self._carry = self._programs.fill(self._carry, self._place(), is_new)

    def _narrow(self) -> None:
        """Move the runs to the smallest number of lanes that is enough for them.

        A stop that is requested during the wait for a program leaves them where they are. They are then
        saved there, and move as soon as the chunk is resumed.
        """
        state = self._state
        least = self._fitting(int((self._map != EMPTY).sum()))
        with contextlib.suppress(Stopped):
            for width in self._chunk.layout.widths:  # a program selects lanes from the next larger number
                if least <= width < len(state.lanes):
                    self._move_to(width)
        self._place()

    def _move_to(self, width: int) -> None:
        state, live = self._state, np.nonzero(self._map != EMPTY)[0]
        start = time.perf_counter()
        self._programs = self._programs_of(width)
        self._waited += time.perf_counter() - start
        selected = np.resize(live, width)  # repeats some runs in the lanes that have none
        self._carry = self._programs.select(self._carry, selected)
        state.started = [state.started[lane] for lane in selected.tolist()]
        state.lanes = [state.lanes[lane] for lane in live.tolist()] + [EMPTY] * (width - len(live))

    def _hand_in(self, lanes: np.ndarray) -> None:
        """Keep the summaries, snapshots and learners of finished runs, and empty their lanes."""
        queued = self._map[lanes]
        points, runs = self._chunk.points[queued], self._chunk.runs[queued]
        # For all lanes, since the compiled program has a fixed shape; rows of unfinished runs are discarded.
        summary = jax.device_get(self._programs.summary(self._carry, self._lanes))
        columns = {name: values[lanes] for name, values in summary.items()}
        self._summaries.append({"point": points, "run": runs} | columns)
        keys = list(zip(lanes.tolist(), points.tolist(), runs.tolist(), strict=True))
        if any(run < self._sink.recorded_runs for _, _, run in keys):
            snapshots = jax.device_get(self._programs.snapshot(self._carry, self._lanes))
            for lane, point, run in keys:
                for name, arrays in snapshots.items() if run < self._sink.recorded_runs else ():
                    kept = {key: values[lane] for key, values in arrays.items()}
                    self._sink.write_snapshot(point, run, name, kept)
        if any(run < self._sink.saved_learners for _, _, run in keys):
            learned = self._programs.exported_state(self._carry, self._lanes)
            for lane, point, run in keys:
                if run < self._sink.saved_learners:
                    of_run = jax.tree.map(lambda leaf, lane=lane: leaf[lane], learned)
                    self._sink.write_learner(point, run, of_run)
        for lane in lanes.tolist():
            self._state.lanes[lane] = EMPTY

    def _write(self) -> None:
        """Write the rows of a segment: the records of its advances, and the summaries of finished runs."""
        tables = self._experiment.tables
        rows: dict[str, list[Rows]] = {"runs": self._summaries}
        for lanes, recorded, records in self._rounds:
            runs = np.where(lanes == EMPTY, EMPTY, self._chunk.runs[lanes])
            points, of_recorded = self._chunk.points[lanes], self._experiment.recorded_tables
            for name, found in fetch_rows(records, tables, points, runs, recorded, of_recorded).items():
                rows.setdefault(name, []).append(found)
        self._sink.write_piece(
            {
                name: to_arrow(KEYS + tables[name], _concatenated(found))
                for name, found in rows.items()
                if found
            }
        )
        self._summaries, self._rounds = [], []


def _concatenated(parts: list[Rows]) -> Mapping[str, np.ndarray]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
