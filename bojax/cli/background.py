"""Reports of finished sweeps, written in other processes while further sweeps run, or after the only one."""

import multiprocessing
import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, wait
from pathlib import Path
from types import TracebackType

from bojax.config.errors import say
from bojax.engine.signals import stop_with_parent
from bojax.numerics.cores import usable_cores
from bojax.report.verdicts import print_verdicts
from bojax.text import duration, error_line

PROCESSES = 4
"""Maximum number of reports that are written at the same time."""

POLL_SECONDS = 0.2
"""Time between two looks at whether a report is written.

A wait without a timeout would not end on Ctrl-C if the kernel gives the signal to another thread.
"""


class Reports:
    """Writes reports. On leaving its `with` block, it waits for all and prints verdicts and paths.

    In the background, other processes write them, at once: drawing holds the interpreter, so that in this
    process it would delay the devices. Otherwise this process writes them on leaving the block, where a
    signal ends it: results are complete by then, and a report has no checkpoint to wait for.
    """

    def __init__(self, *, in_background: bool):
        self.exit_code = 0  # 1 if a report could not be written in the background, 130 after Ctrl-C
        self._pool: ProcessPoolExecutor | None = None
        self._folders: list[Path] = []
        self._pending: dict[Path, Future[Path]] = {}
        if in_background:
            fresh = multiprocessing.get_context("spawn")  # a fork would lack JAX's threads
            processes = min(PROCESSES, usable_cores())
            self._pool = ProcessPoolExecutor(
                processes, mp_context=fresh, initializer=_begin, initargs=(os.getpid(),)
            )

    def __enter__(self) -> "Reports":
        return self

    def prepare(self) -> None:
        """Import the drawing code in a thread: it takes a second, in which this process waits for devices."""
        if self._pool is None:
            threading.Thread(target=_report, daemon=True).start()

    def write(self, folder: Path) -> None:
        """Write the report of a results folder."""
        if self._pool is None:
            self._folders.append(folder)
        else:
            self._pending[folder] = self._pool.submit(_build, folder)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        start = time.monotonic()
        try:
            for folder in list(self._folders) if error is None else ():
                print(_report()(folder))
                self._folders.remove(folder)
            for folder, pending in list(self._pending.items()):
                self._show(folder, pending)
        except KeyboardInterrupt:
            self.exit_code = 128 + signal.SIGINT
            self.stop()
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            if (waited := time.monotonic() - start) >= 1.0:
                print(f"waited {duration(waited)} for reports", file=sys.stderr)

    def stop(self) -> None:
        """Give up reports that are not written, since a signal must be answered at once."""
        left = [*self._folders, *(folder for folder, pending in self._pending.items() if not pending.done())]
        for process in multiprocessing.active_children() if self._pool is not None else ():
            process.kill()
        self._folders.clear()
        for folder in left:
            self._pending.pop(folder, None)
        if left:
            again = shlex.join(["bojax", "report", *map(str, left)])
            what = "the report is not written; to write it"
            if len(left) > 1:
                what = f"{len(left)} reports are not written; to write them"
            say(f"interrupted; {what}: {again}")

    def _show(self, folder: Path, pending: Future[Path]) -> None:
        while not pending.done():
            wait([pending], timeout=POLL_SECONDS)
        try:
            page = pending.result()
            print_verdicts(folder, is_brief=True)
            print(page)
        except Exception as problem:  # the report can be rebuilt from the results, which are complete
            self.exit_code = 1
            reason = f"the report of {folder} cannot be written: {error_line(problem)}"
            say(f"error: {reason}; to try again: bojax report {folder}")
        del self._pending[folder]


def _report() -> Callable[[Path], Path]:
    """The function that writes a report, which imports matplotlib."""
    from bojax.report.progress import report

    return report


def _build(folder: Path) -> Path:
    from bojax.report.build import build_report

    return build_report(folder)


def _begin(parent: int) -> None:
    """Leave signals that a terminal, or `timeout`, sends to every process to the main one, and end after it.

    A pool whose process is killed is not told, and would wait for further reports forever. The main process
    may be killed while this one starts.
    """
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    stop_with_parent(parent, signal.SIGKILL)
