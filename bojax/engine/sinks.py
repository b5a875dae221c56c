"""Sinks: where the rows, snapshots, learners and checkpoints of a chunk go."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import jax
import numpy as np
import pyarrow as pa
from jaxtyping import PyTree
from typing_extensions import override

from bojax.config.settings import Record
from bojax.engine import learners
from bojax.experiments.base import Carry
from bojax.numerics import checkpoint
from bojax.results.chunk_folder import ChunkFolder, ChunkState, Staged

_COMMITS = ThreadPoolExecutor(16, "commit")
"""Threads that commit checkpoints while the devices go on; each waits for Orbax and for the disk."""


class Sink:
    """Receives the rows, snapshots, learners and checkpoints of a chunk.

    This class keeps everything in memory, except for checkpoints.
    """

    def __init__(self, *, recorded_runs: int = 0, saved_learners: int = 0):
        self.state = ChunkState()  # the progress of the chunk, changed while it runs
        # Number of runs of each point, the first ones, of which snapshots and the rows of recorded tables are
        # kept, and of those whose learners are kept
        self.recorded_runs, self.saved_learners = recorded_runs, saved_learners
        self.tables: dict[str, list[pa.Table]] = {}  # the pieces of each table
        # Named arrays by point, run and name; states of learners by point and run
        self.snapshots: dict[tuple[int, int, str], dict[str, np.ndarray]] = {}
        self.learned: dict[tuple[int, int], PyTree] = {}

    def write_piece(self, tables: dict[str, pa.Table]) -> None:
        """Write the rows of a segment."""
        for name, rows in tables.items():
            self.tables.setdefault(name, []).append(rows)

    def write_snapshot(self, point: int, run: int, name: str, arrays: dict[str, np.ndarray]) -> None:
        """Write named arrays of a run that has ended."""
        self.snapshots[point, run, name] = arrays

    def write_learner(self, point: int, run: int, learned: PyTree) -> None:
        """Write the exported state of the learner of a run."""
        self.learned[point, run] = learned

    def save(self, carry: Carry) -> None:
        """Save a checkpoint, possibly in the background; the carry may be given away at once."""
        return

    def wait(self) -> None:
        """Wait until the last checkpoint is saved."""
        return

    def load(self, structure: PyTree[jax.ShapeDtypeStruct]) -> Carry | None:
        """The carry of the last checkpoint; None if there is none."""
        return None

    def finish(self) -> None:
        """Note that the chunk is done."""
        self.state.finish()


class FolderSink(Sink):
    """Writes to the working folder of a chunk, which is open."""

    def __init__(self, files: ChunkFolder, record: Record):
        super().__init__(recorded_runs=record.runs, saved_learners=record.runs if record.learners else 0)
        self.state = files.state
        self._files, self._learned = files, learners.Learned()
        self._commit: Future[None] | None = None

    @override
    def write_piece(self, tables: dict[str, pa.Table]) -> None:
        if self._commit is not None and self._commit.done():
            self.wait()  # raises the error of a failed commit (a full disk) before more rows are written
        self._files.write_piece(tables)

    @override
    def write_snapshot(self, point: int, run: int, name: str, arrays: dict[str, np.ndarray]) -> None:
        self._files.write_snapshot(point, run, name, arrays)

    @override
    def write_learner(self, point: int, run: int, learned: PyTree) -> None:
        if jax.tree.leaves(learned):  # there is no file of nothing
            self._learned.add(point, run, learned)

    @override
    def save(self, carry: Carry) -> None:
        self.wait()
        saved = [checkpoint.save(self._files.add_checkpoint(), checkpoint.arrays(carry))]
        saved += self._save_learners()
        self._commit = _COMMITS.submit(self._end, saved, self._files.stage())

    def _save_learners(self) -> list[Callable[[], None]]:
        if not self._learned:
            return []
        content, self._learned = self._learned.stacked(), learners.Learned()
        return [checkpoint.save(self._files.add_learners(), content)]

    def _end(self, saved: list[Callable[[], None]], staged: Staged) -> None:
        for end in saved:
            end()
        self._files.commit(staged)

    @override
    def wait(self) -> None:
        commit, self._commit = self._commit, None
        if commit is not None:
            commit.result()

    @override
    def load(self, structure: PyTree[jax.ShapeDtypeStruct]) -> Carry:
        return checkpoint.restore(self._files.checkpoint(), structure)

    @override
    def finish(self) -> None:
        self.wait()
        for end in self._save_learners():
            end()
        self.state.finish()
        self._files.commit()
