"""The status of a sweep, read from its folder alone: the chunks done, running, lost and failed."""

import contextlib
import itertools
import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bojax.results.attempts import AttemptRegistry, is_gone
from bojax.results.folder import RunFolder

SILENT_CHECKPOINTS = 5.0
"""Times `checkpoint_seconds` without a written file after which a chunk of another machine counts as lost."""

SAMPLES = 50
"""Number of finished chunks of a group from which the time of the others is estimated."""


@dataclass(frozen=True)
class OpenAttempt:
    """An attempt at a chunk that has not ended."""

    chunk: int  # index of the chunk
    runs: int  # number of its runs
    attempt: int  # number of the attempt
    owner: str  # the process, as `HOST-PID`
    age: float  # seconds since it began
    silence: float  # seconds since it last wrote a file
    is_gone: bool | None  # whether its owner has ended; None if it was not a process of this machine


@dataclass
class Status:
    """The state of an unfinished sweep."""

    name: str  # name of the sweep
    # Kind of the devices that it is planned for; None as long as no worker has planned it
    device: str | None = None
    chunks: int = 0  # number of all chunks
    runs: int = 0  # number of all runs
    done: int = 0  # number of chunks that are done
    runs_done: int = 0  # number of their runs
    paused: int = 0  # number of chunks that wait at a checkpoint
    running: list[OpenAttempt] = field(default_factory=list)  # the chunks that run
    # The chunks whose owner is gone, or is elsewhere and has written nothing for `SILENT_CHECKPOINTS`
    lost: list[OpenAttempt] = field(default_factory=list)
    failed: dict[int, str] = field(default_factory=dict)  # the reason of each failed chunk, by index
    # Seconds per run of the finished chunks times the runs left, divided by the number of running chunks;
    # None if unknown
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

    Times are measured by the clock of the file system, not of this machine or of the process.

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
    attempts = AttemptRegistry(run_folder.work, folder)
    now = _now(run_folder.work)
    most_silence = SILENT_CHECKPOINTS * float(launch.sweep["engine"]["checkpoint_seconds"])
    left: dict[int, int] = {}
    samples: dict[int, list[tuple[str, int]]] = {}
    indices = {_index(name): name for name in attempts.begun()}
    for index, (group, runs) in enumerate(runs_of):
        name = indices.get(index, "")
        if name in attempts.done:
            status.done, status.runs_done = status.done + 1, status.runs_done + runs
            samples.setdefault(group, []).append((name, runs))
            continue
        left[group] = left.get(group, 0) + runs
        if name in attempts.failed:
            status.failed[index] = attempts.reason(name)
        elif name and attempts.paused.get(name) == attempts.newest(name):
            status.paused += 1
        elif name:
            found = _open_attempt(attempts, name, runs, now)
            is_lost = found.silence > most_silence if found.is_gone is None else found.is_gone
            (status.lost if is_lost else status.running).append(found)
    pace = {group: _seconds_per_run(attempts, found) for group, found in samples.items()}
    if pace:
        usual = sum(pace.values()) / len(pace)
        total = sum(runs * pace.get(group, usual) for group, runs in left.items())
        status.seconds_left = total / max(1, len(status.running))
    return status


def _open_attempt(attempts: AttemptRegistry, name: str, runs: int, now: float) -> OpenAttempt:
    number = attempts.newest(name)
    path, attempt = attempts.path(name, number), attempts.attempt(name, number)
    times = []
    for file in (path / "attempt.json", path / "state.json", path):
        try:
            with file.open() if file != path else contextlib.nullcontext():  # renews what NFS knows of it
                times.append(os.stat(file).st_mtime)
        except OSError:  # not written yet, or ended meanwhile
            continue
    owner = "an unknown process" if attempt is None else attempt.owner
    began, wrote = min(times, default=now), max(times, default=now)
    has_ended = None if attempt is None else is_gone(attempt.process)
    return OpenAttempt(_index(name), runs, number, owner, now - began, max(0.0, now - wrote), has_ended)


def _runs_of_chunks(plan: Mapping[str, Any]) -> Iterator[tuple[int, int]]:
    """The group and the number of runs of every chunk; `bojax.engine.chunks.cut` divides a group alike."""
    for group, (points, layout) in enumerate(zip(plan["groups"], plan["layouts"], strict=True)):
        runs = len(points) * plan["runs"]
        for start in range(0, runs, layout["queue"]):
            yield group, min(layout["queue"], runs - start)


def _seconds_per_run(attempts: AttemptRegistry, chunks: Sequence[tuple[str, int]]) -> float:
    seconds = runs = 0.0
    for name, of_chunk in itertools.islice(chunks, SAMPLES):
        noted = attempts.note(name, "done").get("seconds")
        if isinstance(noted, int | float):
            seconds, runs = seconds + noted, runs + of_chunk
    return seconds / runs if runs else 0.0


def _index(name: str) -> int:
    return int(name.split("-")[1])


def _now(work: Path) -> float:
    """The time by the clock of the file system, or else of this machine."""
    try:
        with tempfile.NamedTemporaryFile(dir=work, prefix=".now-") as file:
            return os.fstat(file.fileno()).st_mtime
    except OSError:
        return time.time()
