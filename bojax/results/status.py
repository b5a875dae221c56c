"""The status of a sweep, read from its folder alone: the chunks done, running, lost and failed."""

import itertools
import math
import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bojax.results.folder import RunFolder
from bojax.results.leases import Attempts, is_gone
from bojax.results.store import ResultsError

SAMPLES = 50
"""Number of finished chunks of a group from which the time of the others is estimated."""


@dataclass(frozen=True)
class Held:
    """A chunk that a process has taken.

    Attributes:
        chunk: Index of the chunk.
        runs: Number of its runs.
        attempt: Number of the attempt.
        owner: Name of the process.
        age: Seconds since it was taken.
        silence: Seconds since the last heartbeat of the process.
    """

    chunk: int
    runs: int
    attempt: int
    owner: str
    age: float
    silence: float


@dataclass
class Status:
    """The state of an unfinished sweep.

    Attributes:
        name: Name of the sweep.
        device: Kind of the devices that it is planned for; None as long as no worker has planned it.
        chunks: Number of chunks.
        runs: Number of runs.
        done: Number of chunks that are done.
        runs_done: Number of their runs.
        paused: Number of chunks that were begun and given back.
        running: The chunks that run.
        lost: The chunks whose process was lost; the next worker takes them over.
        failed: The reason of each failed chunk, by index.
        seconds_left: Forecast of the time left with the present number of processes; None if unknown.
    """

    name: str
    device: str | None = None
    chunks: int = 0
    runs: int = 0
    done: int = 0
    runs_done: int = 0
    paused: int = 0
    running: list[Held] = field(default_factory=list)
    lost: list[Held] = field(default_factory=list)
    failed: dict[int, str] = field(default_factory=dict)
    seconds_left: float | None = None

    @property
    def summary(self) -> str:
        """The counts in one line."""
        if self.device is None:
            return f"{self.name}: waiting for the first worker"
        began = self.done + len(self.running) + len(self.lost) + len(self.failed) + self.paused
        counts = {
            "running": len(self.running),
            "lost": len(self.lost),
            "failed": len(self.failed),
            "paused": self.paused,
            "waiting": self.chunks - began,
        }
        rest = "".join(f", {number} {kind}" for kind, number in counts.items() if number)
        return (
            f"{self.name} on {self.device}: {self.done} of {self.chunks} chunks done, "
            f"{self.runs_done} of {self.runs} runs{rest}"
        )


def status_of(folder: Path) -> Status:
    """The state of the unfinished sweep in a results folder.

    How long a process has been silent is measured by the clock of the file system, not by that of this
    machine or of the process.

    Raises:
        ResultsError: There is no unfinished sweep.
    """
    run_folder = RunFolder(folder)
    launch, plan = run_folder.launched(), run_folder.plan()
    status = Status(str(launch.sweep["name"]))
    if plan is None:
        return status
    status.device = plan["device"]["kind"]
    runs_of = list(_runs_of_chunks(plan))
    status.chunks, status.runs = len(runs_of), sum(runs for _, runs in runs_of)
    attempts = Attempts(run_folder.work)
    attempts.look()
    now, seconds = _now(run_folder.work), float(launch.sweep["engine"]["lease_seconds"])
    left: dict[int, int] = {}
    samples: dict[int, list[tuple[str, int]]] = {}
    indices = {_index(name): name for name in attempts.newest}
    for index, (group, runs) in enumerate(runs_of):
        name = indices.get(index, "")
        if name in attempts.complete:
            status.done, status.runs_done = status.done + 1, status.runs_done + runs
            samples.setdefault(group, []).append((name, runs))
            continue
        left[group] = left.get(group, 0) + runs
        if name in attempts.failed:
            status.failed[index] = attempts.reason(name)
        elif name:
            _add(status, attempts, name, runs, now, seconds)
    pace = {group: _seconds_per_run(attempts, found) for group, found in samples.items()}
    if pace:
        usual = sum(pace.values()) / len(pace)
        total = sum(runs * pace.get(group, usual) for group, runs in left.items())
        status.seconds_left = total / max(1, len(status.running))
    return status


def _add(status: Status, attempts: Attempts, name: str, runs: int, now: float, seconds: float) -> None:
    """Add a chunk that a process has taken, and not ended."""
    number = attempts.newest[name]
    path = attempts.path(name, number)
    try:
        lease = attempts.lease(name, number)
        heartbeat = attempts.heartbeat(lease.owner) if lease else None
        age = now - os.stat(path / "lease.json" if lease else path).st_mtime
        silence = now - attempts.heard(lease.owner) if lease and heartbeat else math.inf
    except (OSError, ResultsError):  # damaged, or ended meanwhile
        status.paused += 1
        return
    if lease is not None and lease.is_released:
        status.paused += 1
        return
    owner = lease.owner if lease else "an unknown process"
    held = Held(_index(name), runs, number, owner, max(0.0, age), max(0.0, silence))
    is_lost = heartbeat is None or silence > seconds or is_gone(heartbeat.process)
    (status.lost if is_lost else status.running).append(held)


def _runs_of_chunks(plan: Mapping[str, Any]) -> Iterator[tuple[int, int]]:
    """The group and the number of runs of every chunk; `bojax.engine.chunks.cut` divides a group alike."""
    for group, (points, layout) in enumerate(zip(plan["groups"], plan["layouts"], strict=True)):
        runs = len(points) * plan["runs"]
        for start in range(0, runs, layout["queue"]):
            yield group, min(layout["queue"], runs - start)


def _seconds_per_run(attempts: Attempts, chunks: Sequence[tuple[str, int]]) -> float:
    seconds = runs = 0.0
    for name, of_chunk in itertools.islice(chunks, SAMPLES):
        noted = attempts.outcome(name, attempts.complete[name], "done").get("seconds")
        if isinstance(noted, int | float):
            seconds, runs = seconds + noted, runs + of_chunk
    return seconds / runs if runs else 0.0


def _index(name: str) -> int:
    return int(name.split("-")[1])


def _now(work: Path) -> float:
    """The time by the clock of the file system, or else by that of this machine."""
    try:
        with tempfile.NamedTemporaryFile(dir=work, prefix=".now-") as file:
            return os.fstat(file.fileno()).st_mtime
    except OSError:
        return time.time()
