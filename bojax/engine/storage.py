"""Where a process reads the state of its chunks and writes their rows: a results folder, or memory."""

import contextlib
import os
import secrets
import socket
import threading
import traceback
from collections import defaultdict
from collections.abc import Callable, Sequence

from typing_extensions import override

from bojax.engine.autotuning import Choices
from bojax.engine.chunks import Chunk
from bojax.engine.errors import EngineError, out_of_memory
from bojax.engine.groups import StaticGroup
from bojax.engine.plan import Plan
from bojax.engine.sinks import FolderSink, Sink
from bojax.results.attempts import AttemptRegistry
from bojax.results.chunk_folder import ChunkFolder
from bojax.results.folder import Launch, RunFolder
from bojax.results.store import ResultsError, write_content
from bojax.text import error_line


class Storage:
    """Where the rows of the chunks of a process go. Its methods may be called from any thread.

    This class keeps the rows in memory, and writes no files.

    Args:
        new_sink: Makes a place for the rows of a chunk.
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
