"""Runs a chunk: a part file for each segment of advances, periodic checkpoints, a summary at the end."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import yaml

from bojax.config.files import EXPERIMENT
from bojax.engine.batch import Compiled, Lanes
from bojax.engine.chunks import Chunk
from bojax.engine.errors import FAILURE, EngineError
from bojax.engine.progress import SweepProgress
from bojax.engine.segments import Segment, fetch_rows, run_segment
from bojax.engine.signals import StopRequest
from bojax.experiments.base import Carry
from bojax.numerics import checkpoint
from bojax.results.parts import ChunkFolder
from bojax.results.schema import Table
from bojax.results.store import write_atomically
from bojax.results.tables import KEYS, to_arrow

AT_END = "end"
"""Label of the snapshot of a finished run."""

LEARNED = "learned"
"""Folder of a saved learner's arrays, next to the config that evaluates the learner."""

EVALUATION_EPISODES = 20
"""Number of episodes of an evaluation; `episodes=` overrides it."""


def evaluation(config: Mapping[str, Any]) -> dict[str, Any]:
    """The config that evaluates a learner saved by an experiment of the given config."""
    kept = {name: value for name, value in config.items() if name not in ("kind", "target_return", "tests")}
    changed = {"saved": LEARNED, "schedule": "exploit", "episodes": EVALUATION_EPISODES, "stop": "never"}
    return {"experiment": config["kind"], **kept, **changed, "map_episodes": []}


@dataclass(frozen=True)
class ChunkRunner:
    """Runs the chunks of one static group.

    Attributes:
        program: The compiled group.
        tables: Schemas of the experiment's tables.
        recorded_tables: Tables that keep only the rows of recorded runs.
        recorded_runs: Number of recorded runs of each point, the first ones; their snapshots are kept.
        saves_learners: Whether the learners of recorded runs are saved.
        configs: Resolved config of each point.
        segment_seconds: Wall time of a segment.
        checkpoint_seconds: Minimum time between two checkpoints.
        progress: Progress of the sweep, updated after every segment.
        stop: Request to stop, checked after every advance.
    """

    program: Compiled
    tables: Mapping[str, Table]
    recorded_tables: frozenset[str]
    recorded_runs: int
    saves_learners: bool
    configs: Sequence[Mapping[str, Any]]
    segment_seconds: float
    checkpoint_seconds: float
    progress: SweepProgress
    stop: StopRequest

    def run(self, chunk: Chunk, files: ChunkFolder) -> None:
        """Run a chunk to its end, or to a checkpoint if a stop is requested."""
        state = files.state
        lanes = self.program.place(*chunk.padded(self.program.num_lanes))
        if state.checkpoint is None:
            carry, state.remaining = self.program.init(lanes), chunk.num_lanes
        else:
            carry = checkpoint.restore(files.committed(state.checkpoint), self.program.carry_structure)
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
        rows = fetch_rows(segment.records, self.tables, chunk.points, chunk.runs, self._kept(chunk))
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
        recorded = self._recorded(chunk)
        if recorded.size:
            for name, arrays in jax.device_get(self.program.snapshot(carry, lanes)).items():
                for lane in recorded:
                    kept = {key: values[lane] for key, values in arrays.items()}
                    files.write_snapshot(int(chunk.points[lane]), int(chunk.runs[lane]), name, AT_END, kept)
        if recorded.size and self.saves_learners:
            self._save_learners(chunk, carry, lanes, files, recorded)
        files.state.is_done, files.state.checkpoint = True, None
        files.commit()
        self.progress.end_chunk()

    def _save_learners(
        self, chunk: Chunk, carry: Carry, lanes: Lanes, files: ChunkFolder, recorded: np.ndarray
    ) -> None:
        learned = self.program.exported_state(carry, lanes)
        for lane in recorded if jax.tree.leaves(learned) else ():
            point, run = int(chunk.points[lane]), int(chunk.runs[lane])
            folder = files.learner_folder(point, run)
            text = yaml.safe_dump(evaluation(self.configs[point]), sort_keys=False)
            write_atomically(folder / EXPERIMENT, lambda temporary, text=text: temporary.write_text(text))
            checkpoint.save(folder / LEARNED, jax.tree.map(lambda leaf, lane=lane: leaf[lane], learned))

    def _recorded(self, chunk: Chunk) -> np.ndarray:
        """The lanes of recorded runs."""
        return np.nonzero(chunk.runs < self.recorded_runs)[0]

    def _kept(self, chunk: Chunk) -> dict[str, np.ndarray]:
        return dict.fromkeys(self.recorded_tables, self._recorded(chunk))
