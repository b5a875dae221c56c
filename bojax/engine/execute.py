"""The executor of one machine: worker threads run chunks on its devices, other threads compile ahead."""

import contextlib
import queue
import sys
import threading
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from bojax.engine import program_cache
from bojax.engine.ahead import POLL_SECONDS, Ahead, Stopped
from bojax.engine.batch import Functions, Programs
from bojax.engine.chunks import Chunk, Layout
from bojax.engine.devices import Device, of_platform, turn_of
from bojax.engine.groups import StaticGroup
from bojax.engine.hosted import Hosted
from bojax.engine.progress import GroupProgress, SweepProgress
from bojax.engine.runner import ChunkRunner, Limits, Segment
from bojax.engine.sinks import Sink
from bojax.engine.storage import Storage
from bojax.experiments.base import Experiment
from bojax.numerics.cores import usable_cores
from bojax.results.store import ResultsError

COMPILE_THREADS = 8, 16
"""Maximum number of compilations side by side: on all cores of a small machine, on half of those of a large
one."""

AHEAD_ON_CPU, AHEAD_ON_ACCELERATOR = 24, 192
"""Number of programs that are compiled ahead, and on an accelerator also kept afterwards; they take memory.

A sweep of many groups is held up by tracing, one group after the other, which must go on while groups run. On
a CPU both share the cores.
"""

SWITCH_SECONDS = 5e-4
"""Time after which a thread that holds the interpreter gives it up, if another one wants it.

With Python's 5 ms, a worker waits so long behind tracing after each call of a program.
"""


PATIENCE = 10.0
"""Seconds after a requested stop after which chunks that still run are named."""


@dataclass(eq=False)
class GroupTask:
    """The unfinished chunks of a static group.

    Attributes:
        group: The group.
        experiment: An experiment of the group.
        name: Name for messages.
        seed: Seed of the sweep.
        layout: How the runs are advanced.
        platform: Platform of the devices that they are planned for.
        chunks: Chunks that no thread has taken yet.
        limits: When a chunk pauses.
        storage: Where the rows of the chunks go.
        recorded: Largest number of recorded runs of a chunk.
        running: Number of chunks that threads have taken.
        progress: When it is compiled and run.
    """

    group: StaticGroup
    experiment: Experiment
    name: str
    seed: int
    layout: Layout
    platform: str
    chunks: deque[Chunk]
    limits: Limits
    storage: Storage
    recorded: int = 0
    running: int = field(default=0, init=False)

    def __post_init__(self):
        self.functions = Functions(self.group)
        self.progress = GroupProgress(self.name)

    @property
    def most_steps(self) -> int:
        """Upper bound of the environment steps that are left, of all runs together."""
        num_runs = sum(chunk.num_runs for chunk in self.chunks)
        return num_runs * self.experiment.max_advances * self.experiment.steps_per_advance

    @property
    def kind(self) -> type[Programs]:
        """The class of its programs."""
        return Hosted if self.is_exclusive else Programs

    @property
    def is_exclusive(self) -> bool:
        """Whether only one chunk can run at a time: its environments are on the host."""
        return self.experiment.is_hosted


def compile_threads() -> int:
    """Number of compilations side by side."""
    few, many = COMPILE_THREADS
    return min(max(few, min(many, usable_cores() // 2)), usable_cores())


def most_ahead(device: Device) -> int:
    """Number of programs that are compiled ahead for devices of a platform."""
    return AHEAD_ON_CPU if device.platform == "cpu" else AHEAD_ON_ACCELERATOR


def execute(
    tasks: Sequence[GroupTask],
    workers: Sequence[Device],
    progress: SweepProgress,
    stop: Callable[[], bool],
) -> Iterator[GroupTask]:
    """Run the chunks of all tasks, and yield each task when all its chunks are done or have failed.

    After a requested stop, the chunks that run are paused at a checkpoint, and no further task is yielded.

    Args:
        tasks: The groups with their chunks, in the order in which they are compiled and run.
        workers: The device of each worker thread.
        progress: Where progress is reported.
        stop: Whether a stop is requested.

    Raises:
        ResultsError: A sink cannot be written or read. All other chunks are paused first.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, SWITCH_SECONDS))
    executor = _Executor(tasks, workers, progress, stop)
    try:
        yield from executor.ended()
    finally:
        executor.close()
        sys.setswitchinterval(before)
    if executor.error is not None:
        raise executor.error


class _Executor:
    def __init__(
        self,
        tasks: Sequence[GroupTask],
        workers: Sequence[Device],
        progress: SweepProgress,
        stop: Callable[[], bool],
    ):
        self.error: BaseException | None = None
        self._tasks, self._devices, self._progress = list(tasks), list(dict.fromkeys(workers)), progress
        self._turns = {device: turn_of(device) for device in self._devices}
        self._is_closed = False
        of_each = {device.platform: of_platform(self._tasks, device.platform) for device in self._devices}
        self._ranks = {task: rank for tasks in of_each.values() for rank, task in enumerate(tasks)}
        self._unused: deque[Hashable] = deque()
        self._stop = lambda: self._is_closed or self.error is not None or stop()
        self._changed = threading.Condition(threading.RLock())
        self._ahead: Ahead[Any] = Ahead(compile_threads(), self._changed, self._stop)
        self._ended: queue.Queue[GroupTask] = queue.Queue()
        self._saved: set[GroupTask] = set()
        for task in self._tasks:
            widths = task.layout.widths
            if len(self._devices_of(task)) > 1 and all(self._is_saved(task, width) for width in widths):
                self._saved.add(task)
        self._request_ahead()
        self._workers = [threading.Thread(target=self._work, args=(device,)) for device in workers]
        for worker in self._workers:
            worker.start()

    def ended(self) -> Iterator[GroupTask]:
        left, patience = len(self._tasks), PATIENCE
        while left:
            is_alive = any(worker.is_alive() for worker in self._workers)
            try:
                yield self._ended.get(timeout=POLL_SECONDS if is_alive else 0.0)
                left -= 1
            except queue.Empty:
                if not is_alive:
                    return
                self._progress.tick()
                if self._stop():
                    patience -= POLL_SECONDS
                    if 0.0 >= patience > -POLL_SECONDS:
                        running = [task.name for task in self._tasks if task.running]
                        self._progress.say(f"waiting for the end of an advance: {', '.join(running)}")

    def close(self) -> None:
        with self._changed:
            self._is_closed = True
        for worker in self._workers:
            worker.join()
        self._ahead.close()

    # Compilation

    def _request_ahead(self) -> None:
        """Request the programs of the first unfinished groups, spread over the devices of each platform.

        Programs that an earlier sweep has saved are loaded on several devices at once: on as many as the
        group has chunks.
        """
        left = {device.platform: most_ahead(device) for device in self._devices}
        for task in self._tasks:
            if left[task.platform] > 0 and (task.chunks or task.running):
                most = len(task.chunks) if task in self._saved else 1
                for device in self._in_turn(task)[: max(1, most)]:
                    left[task.platform] -= len(task.layout.widths)
                    for width in task.layout.widths:
                        self._request(task, device, width, is_shown=device == self._first(task))

    def _is_saved(self, task: GroupTask, width: int) -> bool:
        """Whether the programs of a group for a number of lanes are in the cache."""
        wider = task.layout.wider(width)
        key = task.kind.key_of(task.group, self._first(task), width, task.recorded, wider)
        return program_cache.is_saved(key)

    def _first(self, task: GroupTask) -> Device:
        """The device for which a group is compiled first."""
        return self._in_turn(task)[0]

    def _in_turn(self, task: GroupTask) -> list[Device]:
        """The devices on which a group may run, rotated so that successive groups begin on different ones."""
        devices = self._devices_of(task)
        first = self._ranks[task] % len(devices)
        return devices[first:] + devices[:first]

    def _devices_of(self, task: GroupTask) -> list[Device]:
        """The devices on which a group may run."""
        return of_platform(self._devices, task.platform)

    def _request(self, task: GroupTask, device: Device, width: int, *, is_shown: bool = True) -> None:
        key = task, device, width
        self._ahead.request(key, lambda: self._compile(*key, is_shown=is_shown), self._ranks[task])

    def _load(self, task: GroupTask, device: Device, width: int, other: Device) -> None:
        """Load programs that another device has compiled or compiles, in this thread."""
        try:
            can_load = self._ahead.wait((task, other, width)).is_saved
        except Stopped:
            raise
        except BaseException:  # they fail here as well
            can_load = False
        if can_load:
            key = task, device, width
            self._ahead.compute(key, lambda: self._compile(*key, is_shown=False))
        else:
            self._request(task, device, width)

    def _compile(self, task: GroupTask, device: Device, width: int, *, is_shown: bool = True) -> Programs:
        """Compile the programs of a group for a number of lanes on a device, or load them from the cache.

        Args:
            task: The group.
            device: The device.
            width: Number of lanes.
            is_shown: Whether the progress of the group is that of this device.
        """
        is_shown = is_shown and width == task.layout.lanes
        programs = task.kind(
            task.functions,
            device,
            width,
            task.seed,
            recorded=task.recorded,
            wider=task.layout.wider(width),
            choices=task.storage.choices,
            started=lambda: self._progress.compiling(task.progress) if is_shown else None,
        )
        with self._changed:  # a compilation may end after the sweep has ended
            if not self._is_closed:
                if is_shown:
                    self._progress.compiled(task.progress, programs.compile_seconds)
                task.storage.note_compiled(task.group, programs.compile_seconds)
        return programs

    def _programs(self, task: GroupTask, device: Device, width: int) -> Programs:
        """The programs of a group for a number of lanes on a device, once they are there."""
        if not self._ahead.is_requested((task, device, width)):
            others = [
                other for other in self._devices_of(task) if self._ahead.is_requested((task, other, width))
            ]
            if others:  # two devices compile nothing twice
                self._load(task, device, width, others[0])
            else:
                self._request(task, device, width)
        return self._ahead.wait((task, device, width))

    # Workers

    def _work(self, device: Device) -> None:
        try:
            while self._work_on_a_chunk(device) or self._await_chunk(device):
                pass
        except BaseException as error:  # a mistake in the engine; without it, the sweep would seem to be over
            self.error = error

    def _work_on_a_chunk(self, device: Device) -> bool:
        """Run a chunk on a device; False if there is none whose programs are compiled."""
        with contextlib.ExitStack() as turn:
            turn.enter_context(self._turns[device])
            if (taken := self._take(device)) is None:
                return False
            task, chunk = taken
            sink: Sink | None = None
            has_failed = False
            try:
                sink = task.storage.open(chunk)
                if sink is not None:
                    runner = self._runner(task, chunk, sink, device)
                    runner.advance()
                    turn.close()
                    runner.finish()
            except Stopped:
                pass
            except ResultsError as problem:  # of the folder, which all chunks write to
                has_failed, self.error = True, problem
                task.storage.abandon(chunk)
            except BaseException as error:  # user's code may raise anything; a thread gets no Ctrl-C
                has_failed = True
                self._fail(task, [chunk], error)
        self._release(task, chunk, sink, has_failed=has_failed)
        return True

    def _take(self, device: Device) -> tuple[GroupTask, Chunk] | None:
        """The next chunk of a group whose programs are compiled for a device.

        Groups with the programs for all their numbers of lanes come first: they will not wait for any.
        """
        with self._changed:
            while ready := [task for task in self._free(device) if self._is_ready(task, device)]:
                task = next((task for task in ready if self._is_complete(task)), ready[0])
                if self._stop():
                    return None
                try:
                    self._ahead.wait((task, device, task.layout.lanes))
                except BaseException as error:
                    self._fail_all(task, error)
                    continue
                task.running += 1
                return task, task.chunks.popleft()
        return None

    def _await_chunk(self, device: Device) -> bool:
        """Wait until there may be a chunk for a device; False if none is left, or after a requested stop.

        The device's turn is not held meanwhile: another worker may go on with a chunk that has waited for a
        program.
        """
        with self._changed:
            tasks = of_platform(self._tasks, device.platform)
            if not any(task.chunks for task in tasks) or self._stop():
                return False
            free = self._free(device)
            if any(self._is_ready(task, device) for task in free):
                return True
            unknown = [
                task for task in free if not self._ahead.is_requested((task, device, task.layout.lanes))
            ]
            found = [
                (task, other)
                for task in unknown
                for other in self._devices_of(task)
                if self._is_ready(task, other)
            ]
            if not found:
                self._changed.wait(POLL_SECONDS)
                return True
        task, other = next((each for each in found if self._is_complete(each[0])), found[0])
        self._load(task, device, task.layout.lanes, other)
        return True

    def _free(self, device: Device) -> list[GroupTask]:
        """The groups of which a chunk can be run on a device."""
        tasks = of_platform(self._tasks, device.platform)
        return [task for task in tasks if task.chunks and not (task.is_exclusive and task.running)]

    def _is_ready(self, task: GroupTask, device: Device) -> bool:
        return self._ahead.is_ready((task, device, task.layout.lanes))

    def _is_complete(self, task: GroupTask) -> bool:
        """Whether the programs for all numbers of lanes of a group are compiled, each for some device."""
        return all(
            any(self._ahead.is_ready((task, device, width)) for device in self._devices_of(task))
            for width in task.layout.widths
        )

    def _runner(self, task: GroupTask, chunk: Chunk, sink: Sink, device: Device) -> ChunkRunner:
        def report(segment: Segment) -> None:
            self._progress.segment(task.progress, segment)

        def programs(width: int) -> Programs:
            if self._ahead.is_ready((task, device, width)):
                return self._ahead.wait((task, device, width))
            with self._turns[device].away():
                return self._programs(task, device, width)

        self._progress.add([], runs_done=sink.state.num_ended)
        limits = Limits(task.limits.segment_seconds, task.limits.checkpoint_seconds, self._stop)
        return ChunkRunner(chunk, task.experiment, programs, sink, limits, report)

    def _release(self, task: GroupTask, chunk: Chunk, sink: Sink | None, *, has_failed: bool) -> None:
        if sink is not None and not has_failed:
            try:
                task.storage.close(chunk, sink)
            except ResultsError as problem:
                self.error = problem
        with self._changed:
            task.running -= 1
            self._end_if_done(task)
            self._changed.notify_all()

    def _end_if_done(self, task: GroupTask) -> None:
        if task.chunks or task.running or self._stop():
            return
        self._drop_programs(task)
        self._ended.put(task)
        self._request_ahead()

    def _drop_programs(self, task: GroupTask) -> None:
        """Do not compile programs of a group that has ended, and free its oldest ones.

        A GPU keeps many: to free one waits for whatever runs or is measured there, which may last until a
        measurement of XLA's tuning times out, after 0.1 s (openxla/xla#42347).
        """
        for device in self._devices_of(task):
            for width in task.layout.widths:
                key = task, device, width
                if self._ahead.is_ready(key) and device.platform != "cpu":
                    self._unused.append(key)
                else:
                    self._ahead.drop(key)
        while len(self._unused) > AHEAD_ON_ACCELERATOR:
            self._ahead.drop(self._unused.popleft())

    def _fail(self, task: GroupTask, chunks: Sequence[Chunk], error: BaseException) -> None:
        try:
            message = task.storage.fail(chunks, error)
        except ResultsError as problem:
            self.error = problem
            return
        self._progress.failed(task.progress, sum(chunk.num_runs for chunk in chunks), message)

    def _fail_all(self, task: GroupTask, error: BaseException) -> None:
        """Fail the chunks of a group that cannot be compiled."""
        chunks = list(task.chunks)
        task.chunks.clear()
        self._fail(task, chunks, error)
        if self.error is not None:
            return
        self._end_if_done(task)
