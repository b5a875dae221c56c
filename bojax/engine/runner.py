"""Runs one chunk: segments of advances, a part for each, checkpoints now and then, a summary at the end."""

import time
from collections.abc import Mapping
from dataclasses import dataclass

import jax
import numpy as np

from bojax.engine import checkpoint
from bojax.engine.batch import Compiled, Lanes
from bojax.engine.chunks import Chunk
from bojax.engine.errors import FAILURE, EngineError
from bojax.engine.progress import SweepProgress
from bojax.engine.segments import Segment, fetch_rows, run_segment
from bojax.engine.signals import StopRequest
from bojax.experiments.base import Carry
from bojax.results.parts import ChunkFolder
from bojax.results.schema import Table
from bojax.results.tables import KEYS, to_arrow

AT_END = "end"
"""When a finished run's snapshot was taken."""


@dataclass(frozen=True)
class ChunkRunner:
    """Drives the chunks of one static group.

    Attributes:
        program: The compiled group.
        tables: Schemas of the experiment's tables.
        recorded_runs: Snapshots are kept for run indices below this.
        segment_seconds: Wall time of a segment.
        checkpoint_seconds: Least time between two checkpoints.
        progress: Told of every segment.
        stop: Asked after every advance.
    """

    program: Compiled
    tables: Mapping[str, Table]
    recorded_runs: int
    segment_seconds: float
    checkpoint_seconds: float
    progress: SweepProgress
    stop: StopRequest

    def run(self, chunk: Chunk, files: ChunkFolder) -> None:
        """Run a chunk to its end, or up to a checkpoint if a stop is asked for."""
        state = files.state
        lanes = self.program.place(*chunk.padded(self.program.num_lanes))
        if state.checkpoint is None:
            carry, state.remaining = self.program.init(lanes), chunk.num_lanes
        else:
            carry = checkpoint.restore(files.path / state.checkpoint, self.program.carry_structure)
        self.progress.start_chunk(chunk.num_lanes, state.advances / self.program.max_advances)
        saved = time.monotonic()
        while state.remaining and not self.stop:
            segment = self._advance(chunk, carry, lanes, files)
            carry = segment.carry
            is_due = time.monotonic() - saved >= self.checkpoint_seconds
            if state.remaining and (self.stop or is_due):
                state.checkpoint = files.checkpoint_path().name
                checkpoint.save(files.checkpoint_path(), carry)
                files.commit()
                saved = time.monotonic()
        if not state.remaining:
            self._finish(chunk, carry, lanes, files)

    def _advance(self, chunk: Chunk, carry: Carry, lanes: Lanes, files: ChunkFolder) -> Segment:
        state, program = files.state, self.program
        left = program.max_advances - state.advances
        if left <= 0:
            raise EngineError(f"{state.remaining} runs are not done after {state.advances} advances", FAILURE)
        segment = run_segment(program, carry, lanes, state.remaining, self.segment_seconds, left, self.stop)
        rows = fetch_rows(segment.records, self.tables, chunk.points, chunk.runs)
        tables = {name: to_arrow(KEYS + self.tables[name], columns) for name, columns in rows.items()}
        files.write_part(tables)
        state.advances += segment.advances
        state.remaining = segment.remaining
        state.segments.append([chunk.num_lanes, segment.active_steps, segment.seconds])
        self.progress.segment(
            share=state.advances / program.max_advances,
            runs=chunk.num_lanes - segment.remaining,
            steps=segment.active_steps,
            seconds=segment.seconds,
            busy=segment.lane_advances,
            issued=segment.advances * program.num_lanes,
        )
        return segment

    def _finish(self, chunk: Chunk, carry: Carry, lanes: Lanes, files: ChunkFolder) -> None:
        summary = jax.device_get(self.program.summary(carry, lanes))
        columns = {name: values[: chunk.num_lanes] for name, values in summary.items()}
        table = to_arrow(KEYS + self.tables["runs"], {"point": chunk.points, "run": chunk.runs} | columns)
        files.write_part({"runs": table})
        recorded = np.nonzero(chunk.runs < self.recorded_runs)[0]
        if recorded.size:
            for name, arrays in jax.device_get(self.program.snapshot(carry, lanes)).items():
                for lane in recorded:
                    kept = {key: values[lane] for key, values in arrays.items()}
                    files.write_snapshot(int(chunk.points[lane]), int(chunk.runs[lane]), name, AT_END, kept)
        files.state.is_done, files.state.checkpoint = True, None
        files.commit()
        self.progress.end_chunk()
