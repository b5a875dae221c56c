"""A background compiler: threads that compile programs ahead of their first use.

Tracing holds the interpreter's lock; XLA does not. The threads are daemons: a compilation cannot be
interrupted, and the process must not wait for one when the user has stopped it.
"""

import itertools
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future

from bojax.engine.batch import Programs
from bojax.engine.errors import Stopped
from bojax.engine.tasks import ProgramKey
from bojax.numerics.cores import usable_cores

COMPILE_THREADS = 8, 16
"""Maximum number of compilations side by side: on all cores of a small machine, on half of those of a large
one."""

POLL_SECONDS = 0.2
"""Time between two checks for a requested stop."""


def compile_threads() -> int:
    """Number of compilations side by side."""
    few, many = COMPILE_THREADS
    return min(max(few, min(many, usable_cores() // 2)), usable_cores())


class BackgroundCompiler:
    """Compiles the programs of groups in threads, each at most once until they are dropped.

    `changed` is notified whenever a compilation has ended; after a requested stop, none is started.
    """

    def __init__(
        self,
        compile: Callable[[ProgramKey], Programs],
        changed: threading.Condition,
        stop: Callable[[], bool],
    ):
        self._compile, self._changed, self._stop = compile, changed, stop
        self._programs: dict[ProgramKey, Future[Programs]] = {}
        self._queue: queue.PriorityQueue = queue.PriorityQueue()
        self._order = itertools.count()  # keys have no order; this one decides between equal ranks
        for _ in range(compile_threads()):
            threading.Thread(target=self._work, daemon=True).start()

    def request(self, key: ProgramKey, *, is_needed: bool = True) -> None:
        """Compile in a thread, unless that was done before; the first group comes first.

        Programs that are not needed yet come after all that are. Many never are: those for fewer lanes, of a
        group whose runs stay active.
        """
        programs = self._new(key) or (self._programs.get(key) if is_needed else None)
        if programs is not None and not programs.done():  # requested again, it comes earlier
            self._queue.put((not is_needed, key.task.rank, next(self._order), key, programs))

    def load(self, key: ProgramKey, source: ProgramKey) -> None:
        """Obtain programs that another device compiles or has compiled.

        The calling thread loads them, since all others may be busy with long compilations. Programs that
        cannot be loaded are requested.

        Raises:
            Stopped: A stop was requested meanwhile.
        """
        try:
            can_load = self.wait(source).is_saved
        except Stopped:
            raise
        except BaseException:  # they will fail here as well
            can_load = False
        if not can_load:
            self.request(key)
        elif (programs := self._new(key)) is not None:
            self._run(key, programs)

    def is_requested(self, key: ProgramKey) -> bool:
        """Whether programs were requested, and not dropped since."""
        return key in self._programs

    def is_ready(self, key: ProgramKey) -> bool:
        """Whether programs, or an error in their place, are there."""
        programs = self._programs.get(key)
        return programs is not None and programs.done()

    def error(self, key: ProgramKey) -> BaseException | None:
        """Why programs that are ready cannot be used; None if they can."""
        return self._programs[key].exception()

    def wait(self, key: ProgramKey) -> Programs:
        """Requested programs; raises the error that their compilation raised, or `Stopped`."""
        programs = self._programs[key]
        with self._changed:
            while not programs.done():
                if self._stop():
                    raise Stopped
                self._changed.wait(POLL_SECONDS)
        return programs.result()

    def drop(self, key: ProgramKey) -> None:
        """Forget programs, whose memory is then freed, or do not compile them if that has not begun."""
        with self._changed:
            programs = self._programs.pop(key, None)
        if programs is not None:
            programs.cancel()

    def close(self) -> None:
        """End the threads once they are idle."""
        self._queue.put((True, 1 << 30, next(self._order), None, None))  # sorted behind every request

    def _new(self, key: ProgramKey) -> Future[Programs] | None:
        """The place of programs; None if they were requested before."""
        with self._changed:
            if key in self._programs:
                return None
            self._programs[key] = programs = Future()
            return programs

    def _work(self) -> None:
        while True:
            item = self._queue.get()
            *_, key, programs = item
            if key is None or self._stop():
                self._queue.put(item)  # one item ends all threads: each leaves it to the next
                return
            self._run(key, programs)

    def _run(self, key: ProgramKey, programs: Future[Programs]) -> None:
        with self._changed:
            is_over = programs.running() or programs.done()  # requested twice, or dropped before its turn
            if is_over or not programs.set_running_or_notify_cancel():
                return
        try:
            programs.set_result(self._compile(key))
        except BaseException as error:  # user's code may call sys.exit
            programs.set_exception(error)
        with self._changed:
            self._changed.notify_all()
