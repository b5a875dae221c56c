"""Where chunks come from: a folder that several processes may share, or the memory of one process."""

import abc
import traceback
from collections.abc import Callable, Sequence

from typing_extensions import override

from bojax.engine.choices import Choices
from bojax.engine.chunks import Chunk
from bojax.engine.errors import EngineError, out_of_memory
from bojax.engine.groups import StaticGroup
from bojax.engine.plan import Plan
from bojax.engine.sinks import FolderSink, MemorySink, Sink
from bojax.results.folder import Launch, RunFolder
from bojax.results.leases import Leases, Standing
from bojax.results.parts import ChunkFolder
from bojax.results.store import ResultsError, write_content
from bojax.text import error_line


class Share(abc.ABC):
    """The chunks of a sweep as a process sees them. Its methods may be called from any thread.

    Attributes:
        choices: The choices of XLA that belong to the plan; None for a CPU, or if nothing is kept.
    """

    choices: Choices | None = None

    @abc.abstractmethod
    def take(self, chunk: Chunk) -> Sink | None:
        """Take a chunk, and return where its rows go; None if it is not to be run here.

        Raises:
            ResultsError: A file of the chunk cannot be read or written.
        """

    @abc.abstractmethod
    def release(self, chunk: Chunk, sink: Sink) -> None:
        """Give back a chunk, which is done or has been paused."""

    def abandon(self, chunk: Chunk) -> None:
        """Give back a chunk whose files cannot be written here; another process may go on with it."""
        return

    @abc.abstractmethod
    def fail(self, chunks: Sequence[Chunk], error: BaseException) -> str:
        """Note that chunks that this process has taken failed, and return the reason in one line."""

    @abc.abstractmethod
    def note_compiled(self, group: StaticGroup, seconds: float) -> None:
        """Note the seconds of a compilation."""

    def look(self) -> None:
        """See what other processes have taken and finished."""
        return

    def standing(self, chunk: Chunk) -> Standing:
        """What can be done with a chunk, as of the last look."""
        return Standing.FREE

    def is_alive(self, chunk: Chunk) -> bool:
        """Whether a process that holds a chunk has been seen to be alive."""
        return False

    def is_stolen(self, chunk: Chunk) -> bool:
        """Whether another process has taken over a chunk of this one."""
        return False


class MemoryShare(Share):
    """The chunks of a process that writes no files.

    Args:
        new_sink: Makes a place for the rows of a chunk.

    Attributes:
        sinks: What the chunks have produced, by index.
        errors: The errors of chunks that failed.
    """

    def __init__(self, new_sink: Callable[[], MemorySink] = MemorySink):
        self.sinks: dict[int, MemorySink] = {}
        self.errors: list[BaseException] = []
        self._new_sink = new_sink

    @override
    def take(self, chunk: Chunk) -> Sink:
        if chunk.index not in self.sinks:
            self.sinks[chunk.index] = self._new_sink()
        return self.sinks[chunk.index]

    @override
    def release(self, chunk: Chunk, sink: Sink) -> None:
        return

    @override
    def fail(self, chunks: Sequence[Chunk], error: BaseException) -> str:
        self.errors.append(error)
        return error_line(error)

    @override
    def note_compiled(self, group: StaticGroup, seconds: float) -> None:
        return


class FolderShare(Share):
    """The chunks in a results folder, of which this process takes some.

    Attributes:
        plan: The plan.
        folder: The folder.
        leases: The leases of this process.
        failures: Number of chunks that failed in this process.
    """

    def __init__(self, plan: Plan, folder: RunFolder, leases: Leases):
        self.plan, self.folder, self.leases = plan, folder, leases
        if plan.device["platform"] != "cpu":
            self.choices = Choices(folder.choices)
        self.failures = 0
        self._has_ended = False
        self._configs = [point["config"] for point in plan.content["points"]]

    @classmethod
    def join(cls, plan: Plan, folder: RunFolder, launch: Launch, *, is_driver: bool = False) -> "FolderShare":
        """Begin to send heartbeats, and see what is done."""
        leases = Leases(
            folder.work,
            folder.path,
            launch=launch.number,
            seconds=plan.sweep.engine.lease_seconds,
            is_driver=is_driver,
        )
        leases.look()
        leases.start()
        return cls(plan, folder, leases)

    @override
    def take(self, chunk: Chunk) -> Sink | None:
        files = self.leases.take(chunk.name)
        return None if files is None else self._sink(files)

    def _sink(self, files: ChunkFolder) -> Sink:
        return FolderSink(files, self._configs, self.plan.sweep.record)

    @override
    def release(self, chunk: Chunk, sink: Sink) -> None:
        if sink.state.is_done:
            seconds = sum(seconds for _, _, seconds in sink.state.segments)
            self.leases.finish(chunk.name, {"seconds": seconds})
        else:
            self.leases.give_back(chunk.name)

    @override
    def abandon(self, chunk: Chunk) -> None:
        self.leases.give_back(chunk.name)

    @override
    def fail(self, chunks: Sequence[Chunk], error: BaseException) -> str:
        """Note that chunks that this process has taken failed, and return the reason in one line.

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
            self.leases.fail(chunk.name, message)
        self.failures += len(chunks)
        return message

    @override
    def note_compiled(self, group: StaticGroup, seconds: float) -> None:
        self.leases.note_compiled(group.index, seconds)

    @override
    def look(self) -> None:
        if self.folder.work.is_dir():
            self.leases.look()
        else:
            self._has_ended = True  # the driver has merged the sweep

    @override
    def standing(self, chunk: Chunk) -> Standing:
        return Standing.DONE if self._has_ended else self.leases.standing(chunk.name)

    @override
    def is_alive(self, chunk: Chunk) -> bool:
        return self.leases.is_alive(chunk.name)

    @override
    def is_stolen(self, chunk: Chunk) -> bool:
        return self.leases.is_stolen(chunk.name)
