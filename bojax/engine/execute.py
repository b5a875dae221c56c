"""The executor of one machine: worker threads run chunks on its devices, other threads compile ahead."""

import contextlib
import queue
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from bojax.engine.ahead import POLL_SECONDS, Ahead, Stopped
from bojax.engine.batch import Functions, Programs
from bojax.engine.chunks import Chunk, Layout
from bojax.engine.devices import Device, usable_cores, workers_of
from bojax.engine.forecast import ChunkProgress, GroupProgress
from bojax.engine.groups import StaticGroup
from bojax.engine.hosted import Hosted
from bojax.engine.progress import SweepProgress
from bojax.engine.runner import ChunkRunner, Limits, Segment
from bojax.engine.sinks import Sink
from bojax.experiments.base import Experiment
from bojax.results.store import ResultsError

COMPILE_THREADS = 8
"""Maximum number of compilations side by side."""

AHEAD = 24
"""Number of groups that are compiled ahead; their programs take memory."""


LAST = 1 << 20
"""Priority of what nothing waits for: after all compilations."""


@dataclass(eq=False)
class GroupTask:
    """The unfinished chunks of a static group.

    Attributes:
        group: The group.
        experiment: An experiment of the group.
        name: Name for messages.
        seed: Seed of the sweep.
        layout: How the runs are advanced.
        chunks: Chunks that no worker has taken.
        limits: When a chunk pauses.
        compiled: Called with the seconds of a compilation.
        failed: Called with chunks that failed and the error; returns the reason in one line.
        running: Number of chunks that workers have taken.
        recorded: Largest number of recorded runs of a chunk.
    """

    group: StaticGroup
    experiment: Experiment
    name: str
    seed: int
    layout: Layout
    chunks: list[tuple[Chunk, Sink]]
    limits: Limits
    compiled: Callable[[float], None]
    failed: Callable[[Sequence[Chunk], BaseException], str]
    running: int = field(default=0, init=False)

    def __post_init__(self):
        self.functions = Functions(self.group)
        self.recorded = max(
            (int((chunk.runs < sink.recorded_runs).sum()) for chunk, sink in self.chunks), default=0
        )
        self.progress = GroupProgress(self.name, self.experiment.max_advances)
        for chunk, sink in self.chunks:
            self.progress.chunks[chunk.index] = _progress_of(chunk, sink, self.experiment.max_advances)

    @property
    def is_exclusive(self) -> bool:
        """Whether only one chunk can run at a time: its environments are on the host."""
        return self.experiment.is_hosted


def compile_threads() -> int:
    """Number of compilations side by side."""
    return min(COMPILE_THREADS, usable_cores())


def execute(
    tasks: Sequence[GroupTask], devices: Sequence[Device], progress: SweepProgress, stop: Callable[[], bool]
) -> Iterator[GroupTask]:
    """Run the chunks of all tasks, and yield each task when all its chunks are done or have failed.

    After a requested stop, the chunks that run are paused at a checkpoint, and no further task is yielded.

    Raises:
        ResultsError: A sink cannot be written or read. All other chunks are paused first.
    """
    executor = _Executor(tasks, devices, progress, stop)
    try:
        yield from executor.ended()
    finally:
        executor.close()
    if executor.error is not None:
        raise executor.error


class _Executor:
    def __init__(
        self,
        tasks: Sequence[GroupTask],
        devices: Sequence[Device],
        progress: SweepProgress,
        stop: Callable[[], bool],
    ):
        self.error: ResultsError | None = None
        self._tasks, self._devices, self._progress = list(tasks), list(dict.fromkeys(devices)), progress
        self._is_closed = False
        self._kept: list[Hashable] = []
        self._stop = lambda: self._is_closed or self.error is not None or stop()
        self._changed = threading.Condition(threading.RLock())
        self._ahead: Ahead[Any] = Ahead(compile_threads(), self._changed, self._stop)
        self._ended: queue.Queue[GroupTask] = queue.Queue()
        self._request_ahead()
        self._workers = [
            threading.Thread(target=self._work, args=(device,)) for device in workers_of(devices)
        ]
        for worker in self._workers:
            worker.start()

    def ended(self) -> Iterator[GroupTask]:
        left = len(self._tasks)
        while left:
            try:
                yield self._ended.get(timeout=POLL_SECONDS)
                left -= 1
            except queue.Empty:
                if self._stop() and not any(worker.is_alive() for worker in self._workers):
                    return

    def close(self) -> None:
        for key in list(self._kept):  # Python cannot end while a thread is in XLA
            with contextlib.suppress(Exception):  # a requested stop
                self._ahead.wait(key)
        with self._changed:
            self._is_closed = True
        for worker in self._workers:
            worker.join()
        self._ahead.close()

    # Compilation

    def _request_ahead(self) -> None:
        """Request the programs of the first unfinished groups, spread over the devices."""
        unfinished = [(i, task) for i, task in enumerate(self._tasks) if task.chunks or task.running]
        for i, task in unfinished[:AHEAD]:
            device = self._devices[i % len(self._devices)]
            self._request(task, device, task.layout.lanes, priority=i)

    def _request(self, task: GroupTask, device: Device, width: int, priority: int = 0) -> None:
        key = (task, device, width)
        self._ahead.request(key, lambda: self._compile(task, device, width), priority)

    def _compile(self, task: GroupTask, device: Device, width: int) -> Programs:
        is_first = width == task.layout.lanes
        if is_first:
            self._progress.compiling(task.progress)
        for other in self._devices:  # from which these programs are then loaded
            if other != device and self._ahead.is_ready((task, other, width)):
                self._programs(task, other, width).keep()
        kind = Hosted if task.experiment.is_hosted else Programs
        programs = kind(
            task.functions,
            device,
            width,
            task.seed,
            recorded=task.recorded,
            fills=is_first,
        )
        if is_first:
            self._progress.compiled(task.progress, programs.compile_seconds)
            for narrower in task.layout.widths[1:]:  # needed after the first runs have ended
                self._request(task, device, narrower)
        key = task, device, width, "kept"
        self._ahead.request(key, programs.keep, LAST)
        self._kept.append(key)
        with self._changed:  # a compilation may end after the sweep has ended
            if not self._is_closed:
                task.compiled(programs.compile_seconds)
        return programs

    def _programs(self, task: GroupTask, device: Device, width: int) -> Programs:
        self._request(task, device, width)
        return self._ahead.wait((task, device, width))

    # Workers

    def _work(self, device: Device) -> None:
        while (taken := self._take(device)) is not None:
            task, chunk, sink = taken
            try:
                self._run(task, chunk, sink, device)
            except Stopped:
                pass
            except (Exception, SystemExit) as error:  # user's code may call sys.exit
                self._fail(task, [chunk], error)
            self._release(task, chunk)

    def _take(self, device: Device) -> tuple[GroupTask, Chunk, Sink] | None:
        """The next chunk for a device, once its programs are compiled; None if no chunk is left."""
        with self._changed:
            while not self._stop():
                waiting = [task for task in self._tasks if task.chunks]
                if not waiting:
                    return None
                free = [task for task in waiting if not (task.is_exclusive and task.running)]
                ready = [task for task in free if self._is_ready(task, device)]
                if ready:
                    task = ready[0]
                    try:
                        self._ahead.wait((task, device, task.layout.lanes))
                    except BaseException as error:
                        self._fail_all(task, error)
                        continue
                    chunk, sink = task.chunks.pop(0)
                    task.running += 1
                    return task, chunk, sink
                for task in free:  # compiled for another device: loading its program is quick
                    if any(self._is_ready(task, other) for other in self._devices):
                        self._request(task, device, task.layout.lanes)
                        break
                self._changed.wait(POLL_SECONDS)
        return None

    def _is_ready(self, task: GroupTask, device: Device) -> bool:
        return self._ahead.is_ready((task, device, task.layout.lanes))

    def _run(self, task: GroupTask, chunk: Chunk, sink: Sink, device: Device) -> None:
        def report(segment: Segment) -> None:
            self._progress.segment(task.progress, chunk.index, segment)

        limits = Limits(task.limits.segment_seconds, task.limits.checkpoint_seconds, self._stop)
        runner = ChunkRunner(
            chunk,
            task.experiment,
            lambda width: self._programs(task, device, width),
            sink,
            limits,
            report,
        )
        runner.run()

    def _release(self, task: GroupTask, chunk: Chunk) -> None:
        with self._changed:
            task.running -= 1
            if not self._stop():
                self._progress.end_chunk(task.progress, chunk.index)
            self._end_if_done(task)
            self._changed.notify_all()

    def _end_if_done(self, task: GroupTask) -> None:
        if task.chunks or task.running or self._stop():
            return
        for device in self._devices:
            for width in task.layout.widths:
                self._ahead.drop((task, device, width))
        self._ended.put(task)
        self._request_ahead()

    def _fail(self, task: GroupTask, chunks: Sequence[Chunk], error: BaseException) -> None:
        try:
            if isinstance(error, ResultsError):  # of the folder, which all chunks write to
                raise error
            message = task.failed(chunks, error)
        except ResultsError as problem:
            self.error = problem
            return
        num_runs = sum(chunk.num_runs for chunk in chunks)
        self._progress.say(f"failed: {task.name}, {num_runs} runs: {message}")

    def _fail_all(self, task: GroupTask, error: BaseException) -> None:
        """Fail the chunks of a group that cannot be compiled."""
        chunks = [chunk for chunk, _ in task.chunks]
        self._fail(task, chunks, error)
        if self.error is not None:
            return
        task.chunks.clear()
        for chunk in chunks:
            self._progress.end_chunk(task.progress, chunk.index)
        self._end_if_done(task)


def _progress_of(chunk: Chunk, sink: Sink, max_advances: int) -> ChunkProgress:
    state = sink.state
    layout = chunk.layout
    if state.checkpoint is None:
        lanes, live = layout.lanes, min(layout.lanes, chunk.num_runs)
        waiting = chunk.num_runs - live
    else:
        lanes, live = len(state.lanes), sum(1 for run in state.lanes if run >= 0)
        waiting = chunk.num_runs - state.next_run
    return ChunkProgress(lanes, layout.widths[-1], live, waiting, max_advances)
