"""Disks that fill up during a sweep: one line, and with free space the sweep goes on to the same results."""

import contextlib
import random
import resource
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import run, scratch
from benchmarks.campaign.workloads import WORKLOADS, finished, resumed

_WORKLOADS = ("toy", "toy", "tabular", "monitoring", "learner")
_PAGE = 4096


def check(seed: int) -> Outcome:
    """Run a sweep on a disk of a size that follows from the seed, then enlarge the disk and resume."""
    draw = random.Random(f"disk {seed}")
    name = draw.choice(_WORKLOADS)
    with scratch() as place:
        (place / "disk").mkdir()
        out = place / "disk" / "out"
        with _disk(place / "disk", draw, _size(finished(name))) as (what, limit, enlarge):

            def start() -> int:
                limit()
                return WORKLOADS[name].start(out)()

            tried = f"{name} on {what}"
            ended = run(start, place)
            if fault := fault_of(ended, (0, 1)):
                return Outcome(tried, fault)
            enlarge()
            return Outcome(tried, resumed(name, out, place))


@contextlib.contextmanager
def _disk(
    folder: Path, draw: random.Random, needed: int
) -> Iterator[tuple[str, Callable[[], object], Callable[[], object]]]:
    """A small disk at `folder`: its name, what limits a child to it, and what gives it space.

    Without the right to mount one, the size of any file is limited instead.
    """
    size = _PAGE * draw.randint(4, max(5, 2 * needed // _PAGE))
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True).returncode:
        largest = draw.randint(100, max(200, needed // 4))
        yield f"a disk of files up to {largest} bytes", lambda: _limit_files(largest), lambda: None
        return
    try:
        grow = ["mount", "-o", "remount,size=1g", str(folder)]
        yield (f"a disk of {size} bytes", lambda: None, lambda: subprocess.run(grow, check=True))
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def _limit_files(size: int) -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def _size(folder: Path) -> int:
    """Bytes that a results folder takes on a disk of pages."""
    return sum(-(-path.stat().st_size // _PAGE) * _PAGE + _PAGE for path in folder.rglob("*"))
