"""Runs a function in a forked child, under limits, with its output caught and signals sent on the way.

The modules of bojax are imported once, before the first fork: a case then costs what it does, not two
seconds of imports. No backend of JAX may be started in this process, since a fork does not keep its threads.
"""

import contextlib
import ctypes
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

_PR_SET_PDEATHSIG = 1

_SPARE_MEMORY = 4 << 30
"""Address space beyond that of this process; XLA's threads reserve more than they use."""


Signals = Sequence[tuple[float, int]]
"""Times since the start of a child, in seconds, and the signals that are sent then."""


@dataclass(frozen=True)
class ChildResult:
    """How a child ended."""

    code: int  # its exit code; minus the signal's number if a signal ended it
    out: str  # what it wrote to the standard output stream
    err: str  # what it wrote to the standard error stream
    wall: float  # seconds it took
    cpu: float  # seconds of processor time it took
    megabytes: float  # the most memory it held
    is_late: bool  # whether it had to be ended


def import_all() -> None:
    """Import what the commands import when they run, so that no child has to."""
    import importlib

    names = "cli.listing cli.reporting cli.rendering cli.running cli.worker engine.run engine.worker"
    for name in f"{names} report.build films.choose films.film config.external".split():
        importlib.import_module(f"bojax.{name}")


def cli(*words: str) -> int:
    """The command line of bojax; returns its exit code."""
    from bojax.cli.main import main

    return main(words)


class Child:
    """A function that runs in a child whose working folder is `place`; its result is the exit code.

    Args:
        function: What to call.
        place: The working folder.
        is_limited: Whether the child may not take much more memory than this process has.
    """

    def __init__(self, function: Callable[[], int], place: Path, *, is_limited: bool = True):
        self._streams = tempfile.TemporaryFile(), tempfile.TemporaryFile()
        self._start = time.monotonic()
        self._ended: ChildResult | None = None
        self.pid = os.fork()
        if self.pid == 0:
            out, err = (each.fileno() for each in self._streams)
            _be_child(function, place, out, err, is_limited)

    @property
    def wall(self) -> float:
        """Seconds since it started."""
        return time.monotonic() - self._start

    def send(self, number: int) -> None:
        """Send a signal, unless the child has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def poll(self, *, is_late: bool = False) -> ChildResult | None:
        """How it ended; None if it runs."""
        if self._ended is not None:
            return self._ended
        found, status, usage = os.wait4(self.pid, os.WNOHANG)
        if not found:
            return None
        out, err = map(_text, self._streams)
        code, cpu = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
        self._ended = ChildResult(code, out, err, self.wall, cpu, usage.ru_maxrss / 1024, is_late)
        return self._ended

    def wait(self, seconds: float = 90.0, signals: Signals = ()) -> ChildResult:
        """Wait for its end.

        Args:
            seconds: Time since its start after which it is killed.
            signals: Signals to send.
        """
        waiting, is_late = sorted(signals), False
        while (ended := self.poll(is_late=is_late)) is None:
            if waiting and self.wall >= waiting[0][0]:
                self.send(waiting.pop(0)[1])
            elif self.wall > seconds and not is_late:
                is_late = True
                self.send(signal.SIGKILL)
            time.sleep(0.002)
        return ended


def run(
    function: Callable[[], int], place: Path, *, signals: Signals = (), seconds: float = 90.0
) -> ChildResult:
    """Call a function in a child, and wait for its end; see `Child`."""
    return Child(function, place).wait(seconds, signals)


def _be_child(function: Callable[[], int], place: Path, out: int, err: int, is_limited: bool) -> None:
    code = 1
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)  # a campaign that is ended leaves nothing
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(out, 1)
        os.dup2(err, 2)
        # The streams of a terminal without UTF-8 would hide what a surrogate does to one with it.
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)
        sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
        sys.dont_write_bytecode = True
        os.chdir(place)
        if is_limited:
            resource.setrlimit(resource.RLIMIT_AS, (_memory() + _SPARE_MEMORY, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        code = function()
    except SystemExit as leave:
        code = leave.code if isinstance(leave.code, int) else int(leave.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code & 0xFF)


def _text(file: IO[bytes]) -> str:
    """What a file holds, which is closed then."""
    with file:
        file.seek(0)
        return file.read().decode(errors="backslashreplace")


def _memory() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """A folder for one case."""
    with tempfile.TemporaryDirectory(prefix="bojax-case-", ignore_cleanup_errors=True) as name:
        yield Path(name)
