"""The executor of one machine: a thread for each worker runs chunks; a background compiler works ahead."""

import contextlib
import functools
import queue
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from bojax.engine import program_cache
from bojax.engine.batch import Programs
from bojax.engine.chunks import Chunk
from bojax.engine.compile_processes import CompileProcesses, Request, number_of_processes
from bojax.engine.compiler import POLL_SECONDS, BackgroundCompiler
from bojax.engine.devices import Device, new_lock, released
from bojax.engine.errors import Stopped, out_of_memory
from bojax.engine.gpu_clients import shared_memory
from bojax.engine.progress import SweepProgress
from bojax.engine.runner import ChunkRunner
from bojax.engine.scheduler import Scheduler
from bojax.engine.storage import Sink
from bojax.engine.tasks import GroupTask, ProgramKey
from bojax.engine.xla_choices import offer_shipped
from bojax.results.store import ResultsError

SWITCH_SECONDS = 5e-4
"""Time after which a thread that holds the interpreter gives it up, if another one wants it.

With Python's 5 ms, a worker waits so long behind tracing after each call of a program.
"""

PATIENCE = 10.0
"""Seconds after a requested stop after which groups that still run are named."""


def execute(
    tasks: Sequence[GroupTask],
    workers: Sequence[Device],
    progress: SweepProgress,
    stop: Callable[[], bool],
    processes: CompileProcesses | None = None,
) -> Iterator[GroupTask]:
    """Run the chunks of all tasks, and yield each task when all its chunks are done or have failed.

    Each of the workers is a thread with a device. After a requested stop, the chunks that run are paused at a
    checkpoint, and no further task is yielded. Without child processes that compile already, some are started
    if that is worth it.

    Raises:
        ResultsError: A sink cannot be written or read. All other chunks are paused first.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, SWITCH_SECONDS))
    executor = _Executor(tasks, workers, progress, stop, processes)
    try:
        yield from executor.finished_tasks()
    finally:
        executor.close()
        sys.setswitchinterval(before)
    if executor.error is not None:
        raise executor.error


class _Executor:
    """The threads of one machine, and the lock around the scheduler that they share."""

    def __init__(
        self,
        tasks: Sequence[GroupTask],
        workers: Sequence[Device],
        progress: SweepProgress,
        stop: Callable[[], bool],
        processes: CompileProcesses | None,
    ):
        # An error that ends the sweep: of the results folder, or a mistake in the engine
        self.error: BaseException | None = None
        self._progress, self._num_tasks, self._is_closed = progress, len(tasks), False
        self._stop = lambda: self._is_closed or self.error is not None or stop()
        # Reentrant: a thread that holds it calls the compiler, whose methods take it as well.
        self._changed = threading.Condition(threading.RLock())
        self._compiler = BackgroundCompiler(self._compile, self._changed, self._stop)
        self._scheduler = Scheduler(
            tasks,
            workers,
            is_requested=self._compiler.is_requested,
            is_ready=self._compiler.is_ready,
            is_saved=lambda key: program_cache.is_saved(key.name),
        )
        new = [task for task in tasks if task.key(self._scheduler.first(task)).is_new]
        self._processes = processes or CompileProcesses(number_of_processes(len(new), workers))
        for device in dict.fromkeys(workers):
            offer_shipped(device)  # while they start: each would write thousands of files, all at once
        self._locks = {device: new_lock(device) for device in workers}
        self._turns = {device: new_lock(device) for device in workers}
        self._memory = shared_memory(set(workers))
        self._alone: set[Chunk] = set()  # chunks that have run out of memory beside others
        self._ended: queue.Queue[GroupTask] = queue.Queue()
        self._compile_ahead()
        self._workers = [threading.Thread(target=self._work, args=(device,)) for device in workers]
        for worker in self._workers:
            worker.start()

    def finished_tasks(self) -> Iterator[GroupTask]:
        """Yield the groups as they end. The calling thread shows the progress meanwhile."""
        left, patience = self._num_tasks, PATIENCE
        while left:
            # Before the queue is read: a worker may report a group and end in between.
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
                    if 0.0 >= patience > -POLL_SECONDS:  # true once, when the patience has just run out
                        running = ", ".join(task.name for task in self._scheduler.running)
                        self._progress.say(f"waiting for the end of an advance: {running}")

    def close(self) -> None:
        """Pause what runs, and wait for the workers, but not for compilations."""
        with self._changed:
            self._is_closed = True
        for worker in self._workers:
            worker.join()
        self._compiler.close()
        self._processes.close()

    def _compile_ahead(self) -> None:
        for key in self._scheduler.to_compile_ahead():
            self._compiler.request(key, is_needed=key.width == key.task.layout.lanes)

    def _compile(self, key: ProgramKey) -> Programs:
        """Compile programs, or load them from the cache. Those that a group starts with are shown once."""
        task, device, width = key
        is_shown = width == task.layout.lanes and device == self._scheduler.first(task)
        start = functools.cache(lambda: self._progress.compiling(task.progress) if is_shown else None)
        elsewhere = self._compile_elsewhere(key, start)
        programs = task.kind(
            task.functions,
            device,
            width,
            task.seed,
            recorded=task.recorded,
            wider=task.layout.wider(width),
            choices=task.storage.choices,
            started=start,
        )
        seconds = elsewhere + programs.compile_seconds
        with self._changed:  # a compilation may end after the sweep has ended
            if not self._is_closed:
                if is_shown:
                    self._progress.compiled(task.progress, seconds)
                task.storage.note_compiled(task.group, seconds)
        return programs

    def _compile_elsewhere(self, key: ProgramKey, started: Callable[[], None]) -> float:
        """Have a child process compile programs that are new; returns its seconds."""
        if not self._processes or not key.is_new:
            return 0.0
        started()
        seconds = self._processes.compile(Request.of(key))
        if self._stop():  # which has ended the child
            raise Stopped
        return seconds

    def _work(self, device: Device) -> None:
        """A worker thread."""
        try:
            while self._run_next(device) or self._await_next(device):
                pass
        except BaseException as error:  # a mistake in the engine; without it, the sweep would seem to be over
            self.error = error

    def _run_next(self, device: Device) -> bool:
        """Run a chunk on a device; False if none is ready."""
        with contextlib.ExitStack() as lock, contextlib.ExitStack() as turn:
            # Before a chunk is taken: a thread that waits for the device keeps no chunk from others. While it
            # waits for memory, the device is not locked, but no other thread of the device takes a chunk.
            turn.enter_context(self._turns[device])
            lock.enter_context(self._locks[device])
            if (taken := self._take(device)) is None:
                return False
            task, chunk = taken
            sink: Sink | None = None
            try:
                sink = task.storage.open(chunk)
                if sink is not None:
                    runner = self._runner(task, chunk, sink, device)
                    self._hold_memory(lock, task, chunk, device)
                    turn.close()
                    runner.advance()
                    lock.close()  # the last rows are written while another chunk uses the device
                    runner.finish()
                    task.storage.close(chunk, sink)
            except Stopped:
                task.storage.abandon(chunk)
            except ResultsError as problem:  # of the folder, which all chunks write to
                self.error = problem
                task.storage.abandon(chunk)
            except BaseException as error:  # user's code may raise anything; a thread gets no Ctrl-C
                if not self._runs_again(task, chunk, device, error):
                    self._fail(task, [chunk], error)
        self._release(task)
        return True

    def _runs_again(self, task: GroupTask, chunk: Chunk, device: Device, error: BaseException) -> bool:
        """Whether a chunk that failed is put back, to go on alone: if it lacked memory beside others."""
        if device not in self._memory or chunk in self._alone or out_of_memory(error, 1) is None:
            return False
        task.storage.abandon(chunk)
        with self._changed:
            self._alone.add(chunk)
            task.chunks.appendleft(chunk)
        return True

    def _hold_memory(self, lock: contextlib.ExitStack, task: GroupTask, chunk: Chunk, device: Device) -> None:
        """Hold the memory that a chunk needs until the device is unlocked, if it shares a GPU with others.

        Raises:
            Stopped: A stop was requested meanwhile.
        """
        if (memory := self._memory.get(device)) is not None:
            programs = self._compiler.wait(task.key(device))
            needed = None if chunk in self._alone else programs.needed_memory
            # A thread that waits for memory must hold no lock that one which has memory may wait for.
            with released(self._locks[device]):
                lock.enter_context(memory.held(needed))
            if self._stop():
                raise Stopped

    def _take(self, device: Device) -> tuple[GroupTask, Chunk] | None:
        """The next chunk for a device. Groups that cannot be compiled fail here, with all their chunks."""
        with self._changed:
            while not self._stop() and (taken := self._scheduler.take(device)) is not None:
                task, chunk = taken
                error = self._compiler.error(task.key(device))
                if error is None:
                    return taken
                chunks = [chunk, *task.chunks]
                task.chunks.clear()
                self._fail(task, chunks, error)
                self._release(task)
        return None

    def _await_next(self, device: Device) -> bool:
        """Wait until there may be a chunk for a device; False if none is left, or after a requested stop.

        The device is not locked meanwhile: another worker may go on with a chunk that has waited for a
        program.
        """
        with self._changed:
            if self._stop() or self._scheduler.is_over(device):
                return False
            found = self._scheduler.to_load(device)
            if found is None:
                # Under the lock, so that no compilation ends between the question and the wait.
                if not self._scheduler.ready(device):
                    self._changed.wait(POLL_SECONDS)
                return True
        self._compiler.load(*found)
        return True

    def _runner(self, task: GroupTask, chunk: Chunk, sink: Sink, device: Device) -> ChunkRunner:
        def programs(width: int) -> Programs:
            key = task.key(device, width)
            if self._compiler.is_ready(key):
                return self._compiler.wait(key)
            # Another chunk may use the device while this one waits for a program, or loads it.
            with released(self._locks[device]):
                if (source := source_of(key)) is not None:
                    self._compiler.load(key, source)
                else:
                    self._compiler.request(key)
                return self._compiler.wait(key)

        def source_of(key: ProgramKey) -> ProgramKey | None:
            with self._changed:
                return None if self._compiler.is_requested(key) else self._scheduler.source(key)

        def announce(width: int) -> None:
            if source_of(key := task.key(device, width)) is None:
                self._compiler.request(key)

        self._progress.add([], runs_done=sink.state.num_ended)
        limits = replace(task.limits, stop=self._stop)
        report = self._progress.segment
        return ChunkRunner(
            chunk, task.experiment, programs, sink, limits, lambda done: report(task.progress, done), announce
        )

    def _release(self, task: GroupTask) -> None:
        """Note that a chunk no longer runs; after the last one, report its group and free the programs."""
        with self._changed:
            # A stop pauses chunks, so that a group without chunks left is not necessarily done.
            if self._scheduler.release(task) and not self._stop():
                for key in self._scheduler.unneeded(task):
                    self._compiler.drop(key)
                self._ended.put(task)
                self._compile_ahead()
            self._changed.notify_all()

    def _fail(self, task: GroupTask, chunks: Sequence[Chunk], error: BaseException) -> None:
        try:
            message = task.storage.fail(chunks, error)
        except ResultsError as problem:
            self.error = problem
            return
        self._progress.failed(task.progress, sum(chunk.num_runs for chunk in chunks), message)
