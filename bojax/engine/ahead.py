"""Compilation in threads, ahead of the first use of a program.

Tracing holds the interpreter's lock; XLA does not. The threads are daemons: a compilation cannot be
interrupted, and the process must not wait for one when the user has stopped it.
"""

import itertools
import queue
import threading
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from typing import Generic, TypeVar

POLL_SECONDS = 0.2
"""Time between two checks for a requested stop."""

T = TypeVar("T")


class Stopped(Exception):
    """A stop was requested before a result was there."""


class Ahead(Generic[T]):
    """Results that threads compute ahead, by key.

    Args:
        num_threads: Number of threads.
        changed: Notified whenever a result is there.
        stop: Whether a stop is requested; no computation is started after that.
    """

    def __init__(self, num_threads: int, changed: threading.Condition, stop: Callable[[], bool]):
        self._changed, self._stop = changed, stop
        self._results: dict[Hashable, Future[T]] = {}
        self._queue: queue.PriorityQueue = queue.PriorityQueue()
        self._order = itertools.count()
        for _ in range(num_threads):
            threading.Thread(target=self._work, daemon=True).start()

    def request(self, key: Hashable, compute: Callable[[], T], priority: int = 0) -> None:
        """Compute a result in a thread, unless it was requested before; a low priority comes first."""
        if (result := self._new(key)) is not None:
            self._queue.put((priority, next(self._order), compute, result))

    def compute(self, key: Hashable, compute: Callable[[], T]) -> None:
        """Compute a result in the calling thread, unless it was requested before."""
        if (result := self._new(key)) is not None:
            self._run(compute, result)

    def is_requested(self, key: Hashable) -> bool:
        """Whether a result was requested, and not dropped since."""
        return key in self._results

    def is_ready(self, key: Hashable) -> bool:
        """Whether a result, or an error in its place, is there."""
        result = self._results.get(key)
        return result is not None and result.done()

    def wait(self, key: Hashable) -> T:
        """A requested result; raises the error that its computation raised, or `Stopped`."""
        result = self._results[key]
        with self._changed:
            while not result.done():
                if self._stop():
                    raise Stopped
                self._changed.wait(POLL_SECONDS)
        return result.result()

    def drop(self, key: Hashable) -> None:
        """Forget a result, whose memory is then freed, or do not compute it if that has not begun."""
        with self._changed:
            result = self._results.pop(key, None)
        if result is not None:
            result.cancel()

    def close(self) -> None:
        """End the threads once they are idle."""
        self._queue.put((1 << 30, next(self._order), None, None))

    def _new(self, key: Hashable) -> Future[T] | None:
        """The place of a result; None if it was requested before."""
        with self._changed:
            if key in self._results:
                return None
            self._results[key] = result = Future()
            return result

    def _work(self) -> None:
        while True:
            item = self._queue.get()
            _, _, compute, result = item
            if compute is None or self._stop():
                self._queue.put(item)  # for the other threads
                return
            self._run(compute, result)

    def _run(self, compute: Callable[[], T], result: Future[T]) -> None:
        if not result.set_running_or_notify_cancel():
            return
        try:
            result.set_result(compute())
        except BaseException as error:  # user's code may call sys.exit
            result.set_exception(error)
        with self._changed:
            self._changed.notify_all()
