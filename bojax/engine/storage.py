"""Where a process reads the state of its chunks and writes their rows: a results folder, or memory.

A `Storage` is that of all chunks of a process, a `Sink` that of one of them.
"""

import contextlib
import os
import secrets
import socket
import threading
import traceback
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import jax
import numpy as np
import pyarrow as pa
from jaxtyping import PyTree
from typing_extensions import override

from bojax.config.settings import Record
from bojax.engine import learners
from bojax.engine.autotuning import Choices
from bojax.engine.chunks import Chunk
from bojax.engine.errors import EngineError, out_of_memory
from bojax.engine.groups import StaticGroup
from bojax.engine.plan import Plan
from bojax.experiments.base import Carry
from bojax.numerics import checkpoint
from bojax.results.attempts import AttemptRegistry
from bojax.results.chunk_folder import ChunkFolder, ChunkState
from bojax.results.folder import Launch, RunFolder
from bojax.results.store import ResultsError, write_content
from bojax.text import error_line

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

    def _end(self, saved: list[Callable[[], None]], staged: tuple[ChunkState, list[str]]) -> None:
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


class Storage:
    """Where the rows of the chunks of a process go. Its methods may be called from any thread.

    This class keeps the rows in memory, in a new sink for each chunk, and writes no files.
    """

    # The choices of XLA that belong to the plan; None for a CPU, or if nothing is kept
    choices: Choices | None = None

    def __init__(self, new_sink: Callable[[], Sink] = Sink):
        self.sinks: dict[int, Sink] = {}  # what the chunks have produced, by index
        self.errors: list[BaseException] = []  # of chunks that failed
        self._new_sink = new_sink

    def open(self, chunk: Chunk) -> Sink | None:
        """Open a sink for the rows of a chunk; None if the chunk is done or has failed.

        Raises:
            ResultsError: A file of the chunk cannot be read or written.
        """
        if chunk.index not in self.sinks:
            self.sinks[chunk.index] = self._new_sink()
        return self.sinks[chunk.index]

    def close(self, chunk: Chunk, sink: Sink) -> None:
        """Note that a chunk is done, or has been paused at a checkpoint."""
        return

    def abandon(self, chunk: Chunk) -> None:
        """Note that this process gives up a chunk, after a requested stop or an error of its files."""
        return

    def fail(self, chunks: Sequence[Chunk], error: BaseException) -> str:
        """Note that chunks have failed, and return the reason in one line."""
        self.errors.append(error)
        return error_line(error)

    def note_compiled(self, group: StaticGroup, seconds: float) -> None:
        """Note the seconds of a compilation."""
        return


class FolderStorage(Storage):
    """Attempts at the chunks that a launch gave this process, in a results folder."""

    def __init__(self, plan: Plan, folder: RunFolder, launch: Launch, attempts: AttemptRegistry):
        super().__init__()
        self.plan, self.folder, self._launch, self._attempts = plan, folder, launch, attempts
        if plan.device["platform"] != "cpu":
            self.choices = Choices(folder.choices)
        self.failures = 0  # number of chunks that failed in this process
        self._open: dict[Chunk, ChunkFolder] = {}
        self._owner = f"{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(3)}"
        self._compiled: dict[int, float] = defaultdict(float)
        self._lock = threading.Lock()

    def unfinished(self, chunks: Sequence[Chunk]) -> list[Chunk]:
        """The chunks that are neither done nor failed."""
        return [chunk for chunk in chunks if not self._attempts.has_ended(chunk.name)]

    @override
    def open(self, chunk: Chunk) -> Sink | None:
        files = self._attempts.begin(chunk.name, self._launch.identity)
        if files is None:
            return None
        self._open[chunk] = files
        return FolderSink(files, self.plan.sweep.record)

    @override
    def close(self, chunk: Chunk, sink: Sink) -> None:
        if not sink.state.is_done:
            return self.abandon(chunk)
        seconds = sum(seconds for _, _, seconds in sink.state.segments)
        return self._attempts.end(self._open.pop(chunk), "done", {"seconds": seconds})

    @override
    def abandon(self, chunk: Chunk) -> None:
        files = self._open.pop(chunk, None)
        if files is not None:
            with contextlib.suppress(ResultsError):  # without this file, the attempt counts as lost
                self._attempts.end(files, "paused", {})

    @override
    def fail(self, chunks: Sequence[Chunk], error: BaseException) -> str:
        """Note that chunks have failed, and return the reason in one line.

        The traceback of an unexpected error is kept in a file.
        """
        known = error if isinstance(error, EngineError) else out_of_memory(error, chunks[0].layout.lanes)
        message = str(known or error_line(error))
        if known is None and not isinstance(error, ResultsError):
            stack = self.folder.work / f"error-{chunks[0].index:05d}.txt"
            text = "".join(traceback.format_exception(error))
            write_content(stack, text.encode(errors="backslashreplace"))
            message += f" (traceback in {stack})"
        for chunk in chunks:
            files = self._open.pop(chunk, None) or self._attempts.begin(chunk.name, self._launch.identity)
            if files is not None:
                self._attempts.end(files, "failed", {"error": message})
        self.failures += len(chunks)
        return message

    @override
    def note_compiled(self, group: StaticGroup, seconds: float) -> None:
        # On a full disk, the sink that writes rows reports the error; compile times are not worth a failure.
        with self._lock, contextlib.suppress(ResultsError):
            self._compiled[group.index] += seconds
            self.folder.note_compiled(self._owner, self._compiled)
