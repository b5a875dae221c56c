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

_PR_SET_PDEATHSIG = 1

_SPARE_MEMORY = 4 << 30
"""Address space beyond that of this process; XLA's threads reserve more than they use."""


@dataclass(frozen=True)
class Ended:
    """How a child ended.

    Attributes:
        code: Its exit code; minus the signal's number if a signal ended it.
        out: What it wrote to the standard output stream.
        err: What it wrote to the standard error stream.
        wall: Seconds it took.
        cpu: Seconds of processor time it took.
        megabytes: The most memory it held.
        is_late: Whether it had to be ended.
    """

    code: int
    out: str
    err: str
    wall: float
    cpu: float
    megabytes: float
    is_late: bool


def import_all() -> None:
    """Import what the commands import when they run, so that no child has to."""
    import importlib

    for name in ("cli.listing", "cli.reporting", "cli.rendering", "cli.running", "engine.run"):
        importlib.import_module(f"bojax.{name}")
    for name in ("report.build", "report.animations.choose", "report.animations.film", "config.external"):
        importlib.import_module(f"bojax.{name}")


def run(
    function: Callable[[], int],
    place: Path,
    *,
    signals: Sequence[tuple[float, int]] = (),
    seconds: float = 90.0,
) -> Ended:
    """Call a function in a child whose working folder is `place`; its result is the exit code.

    Args:
        function: What to call.
        place: The working folder.
        signals: `(delay in seconds, signal)`, sent in this order.
        seconds: Time after which the child is killed.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        start = time.monotonic()
        pid = os.fork()
        if pid == 0:
            _be_child(function, place, out.fileno(), err.fileno())
        waiting, is_late = sorted(signals), False
        while True:
            found, status, usage = os.wait4(pid, os.WNOHANG)
            if found:
                break
            wall = time.monotonic() - start
            if waiting and wall >= waiting[0][0]:
                os.kill(pid, waiting.pop(0)[1])
            elif wall > seconds:
                is_late = True
                os.kill(pid, signal.SIGKILL)
                seconds = float("inf")
            time.sleep(0.002)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode(errors="backslashreplace"))
    return Ended(
        code=os.waitstatus_to_exitcode(status),
        out=texts[0],
        err=texts[1],
        wall=time.monotonic() - start,
        cpu=usage.ru_utime + usage.ru_stime,
        megabytes=usage.ru_maxrss / 1024,
        is_late=is_late,
    )


def _be_child(function: Callable[[], int], place: Path, out: int, err: int) -> None:
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


def _memory() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """A folder for one case."""
    with tempfile.TemporaryDirectory(prefix="bojax-case-", ignore_cleanup_errors=True) as name:
        yield Path(name)
