"""Leases: which process runs which chunk of a working folder, without locks.

Several processes, on several machines, share the chunks of a sweep through its working folder. An attempt at
a chunk is a folder of its own, `<chunk>-<number>`, made by `mkdir`, which succeeds for one process alone, on
NFS too. A process that was paused and has lost its lease can therefore write to its own attempt only. The
files are:

- `<chunk>-<number>/lease.json`: the owner of the attempt, written once, and again when it is given back;
- `<chunk>-<number>.done`, `<chunk>-<number>.failed`: how the attempt ended;
- `worker-<owner>.json`: the heartbeat of a process, a counter.

A lease ends when its owner gives it back, or when the owner's counter has not changed for some time by the
clock of the process that looks. The clocks of different machines are never compared. If the owner was a
process of the same machine that is gone, its lease ends at once.
"""

import contextlib
import enum
import os
import re
import secrets
import shutil
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pydantic

from bojax.results.parts import ChunkFolder
from bojax.results.store import ResultsError, explained, read_json, write_json

BEATS = 6
"""Heartbeats in the time after which a lease without any ends."""

MOST_LOSSES = 2
"""Number of owners that a chunk may lose, one after the other and without a commit, before it has failed."""

_NAME = re.compile(r"(?P<chunk>chunk-\d{5,}-[0-9a-f]{12})-(?P<number>\d+)(?P<outcome>\.done|\.failed)?")
_LEASE = "lease.json"
_WORKER = "worker-"


class Standing(enum.Enum):
    """What can be done with a chunk: it is free, held by a process, done or failed."""

    FREE = "free"
    HELD = "held"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class Lease:
    """The right of a process to run a chunk.

    Attributes:
        owner: Name of the process.
        launch: Number of the launch to which the process belongs.
        parts: Number of committed parts with which the attempt began.
        losses: Number of earlier owners, one after the other, that were lost without a commit.
        is_released: Whether the owner has given it back.
    """

    owner: str
    launch: int
    parts: int = 0
    losses: int = 0
    is_released: bool = False


@dataclass(frozen=True)
class Heartbeat:
    """A sign of life of a process.

    Attributes:
        beats: A counter, increased while the process lives.
        seconds: Time since the process started, by its own clock.
        launch: Number of the launch to which the process belongs.
        is_driver: Whether the process merges the sweep in the end. There is one such process at a time.
        process: Identifies the process on its machine; None if the system does not tell.
        compile_seconds: Seconds of compilation in this process, by index of the group.
    """

    beats: int
    seconds: float
    launch: int
    is_driver: bool
    process: list[str] | None
    compile_seconds: dict[str, float] = field(default_factory=dict)


class Attempts:
    """The attempts at each chunk in a working folder, and how they ended, as of the last `look`.

    Attributes:
        work: The working folder.
        newest: Number of the newest attempt at each chunk that has any.
        complete: Number of the newest complete attempt at each chunk that has one.
        failed: Number of the newest failed attempt at each chunk that has one.
    """

    def __init__(self, work: Path):
        self.work = work
        self.newest: dict[str, int] = {}
        self.complete: dict[str, int] = {}
        self.failed: dict[str, int] = {}

    def look(self) -> None:
        """List the folder. The outcome of an attempt whose folder was deleted does not count."""
        folders: dict[str, set[int]] = {}
        outcomes: dict[str, list[tuple[str, int]]] = {".done": [], ".failed": []}
        with explained(self.work, "read"):
            names = os.listdir(self.work)
        newest: dict[str, int] = {}
        for name in names:
            if match := _NAME.fullmatch(name):
                chunk, number = match["chunk"], int(match["number"])
                newest[chunk] = max(newest.get(chunk, 0), number)  # a number is never used twice
                if match["outcome"]:
                    outcomes[match["outcome"]].append((chunk, number))
                else:
                    folders.setdefault(chunk, set()).add(number)
        self.newest = newest
        self.complete, self.failed = (_last(outcomes[kind], folders) for kind in (".done", ".failed"))

    def path(self, chunk: str, number: int) -> Path:
        """The folder of an attempt."""
        return self.work / f"{chunk}-{number}"

    def lease(self, chunk: str, number: int) -> Lease | None:
        """The lease of an attempt; None if there is none yet.

        Raises:
            ResultsError: It is damaged.
        """
        return _read(self.path(chunk, number) / _LEASE, Lease)

    def heartbeat(self, owner: str) -> Heartbeat | None:
        """The last heartbeat of a process; None if there is none.

        Raises:
            ResultsError: It is damaged.
        """
        return _read(self._heart(owner), Heartbeat)

    def heard(self, owner: str) -> float:
        """Time of the last heartbeat of a process, by the clock of the file system."""
        with self._heart(owner).open() as file:  # on NFS, opening a file renews what is known of it
            return os.fstat(file.fileno()).st_mtime

    def _heart(self, owner: str) -> Path:
        return self.work / f"{_WORKER}{owner}.json"

    def heartbeats(self) -> dict[str, Heartbeat]:
        """The last heartbeat of every process."""
        found = {}
        for path in sorted(self.work.glob(f"{_WORKER}*.json")):
            owner = path.stem.removeprefix(_WORKER)
            try:
                heartbeat = self.heartbeat(owner)
            except ResultsError:
                continue
            if heartbeat is not None:
                found[owner] = heartbeat
        return found

    def reason(self, chunk: str) -> str:
        """Why the newest failed attempt at a chunk failed, in one line."""
        content = self.outcome(chunk, self.failed[chunk], "failed")
        return str(content.get("error", "for a reason that is damaged"))

    def outcome(self, chunk: str, number: int, kind: str) -> dict[str, Any]:
        """What was noted at the end of an attempt; empty if it is damaged."""
        try:
            content = read_json(self._marker(chunk, number, kind))
        except ResultsError:
            return {}
        return content if isinstance(content, dict) else {}

    def committed(self, chunk: str, results: Path) -> ChunkFolder | None:
        """The files of a chunk: those of the newest complete attempt, or of the newest one with a commit.

        Raises:
            ResultsError: A committed file is missing or has changed.
        """
        last = self.complete.get(chunk, self.newest.get(chunk, 0))
        for number in range(last, 0, -1):
            files = ChunkFolder(self.path(chunk, number), results, chunk)
            if files.read():
                return files
        return None

    def _marker(self, chunk: str, number: int, kind: str) -> Path:
        return self.work / f"{chunk}-{number}.{kind}"

    def mark(self, chunk: str, number: int, kind: str, content: Mapping[str, Any]) -> None:
        """Note how an attempt ended."""
        write_json(self._marker(chunk, number, kind), content, durably=False)

    def unmark(self, chunk: str, number: int, kind: str) -> None:
        """Forget how an attempt ended."""
        path = self._marker(chunk, number, kind)
        with explained(path, "deleted"):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)


class Leases:
    """The leases of this process, and what it knows of those of others.

    Its methods may be called from any thread.

    Args:
        work: The working folder.
        results: The results folder.
        launch: Number of the launch; losses are counted anew in each.
        seconds: Time without a heartbeat after which a lease ends.
        is_driver: Whether this process merges the sweep in the end. Leases of earlier drivers have ended,
            since the folder has one driver at a time.
        clock: Seconds by the clock of this process.
        owner: Name of this process; made of the machine and the process by default.
    """

    def __init__(
        self,
        work: Path,
        results: Path,
        *,
        launch: int,
        seconds: float,
        is_driver: bool = False,
        clock: Callable[[], float] = time.monotonic,
        owner: str | None = None,
    ):
        self.attempts = Attempts(work)
        self.owner = owner or f"{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(3)}"
        self._results, self._launch, self._seconds, self._is_driver = results, launch, seconds, is_driver
        self._clock, self._start = clock, clock()
        self._beats = 0
        self._compile_seconds: dict[str, float] = {}
        self._process = process_identity(os.getpid())
        self._mine: dict[str, int] = {}
        self._stolen: set[str] = set()
        self._ended: set[tuple[str, int]] = set()
        self._seen: dict[str, tuple[int, float, bool]] = {}  # counter, when it changed, whether it did
        self._looked = -float("inf")
        self._is_stale = True
        self._lock = threading.RLock()
        self._beating = threading.Lock()
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    # Heartbeats

    def start(self) -> None:
        """Send heartbeats from a thread, until `close`."""
        self.beat()
        self._thread = threading.Thread(target=self._pulse, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Send a last heartbeat."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
            with contextlib.suppress(ResultsError):
                self.beat()

    def note_compiled(self, group: int, seconds: float) -> None:
        """Add to the seconds of compilation that heartbeats tell."""
        with self._lock:
            before = self._compile_seconds.get(str(group), 0.0)
            self._compile_seconds[str(group)] = before + seconds

    def beat(self) -> None:
        """Send a heartbeat, and look which leases of this process others have taken over."""
        # One at a time: two would share the temporary file, and a torn heartbeat ends this process's leases.
        with self._beating:
            with self._lock:
                self._beats += 1
                seconds = self._clock() - self._start
                beat = Heartbeat(
                    self._beats,
                    seconds,
                    self._launch,
                    self._is_driver,
                    self._process,
                    dict(self._compile_seconds),
                )
                held = dict(self._mine)
            write_json(self.attempts.work / f"{_WORKER}{self.owner}.json", asdict(beat), durably=False)
        for chunk, number in held.items():
            if os.path.lexists(self.attempts.path(chunk, number + 1)):
                self._stolen.add(chunk)

    def _pulse(self) -> None:
        while not self._closing.wait(self._seconds / BEATS):
            try:
                self.beat()
            except ResultsError:  # the disk is full or away; whoever writes rows will say so
                continue

    # Chunks

    def look(self, at_most_every: float = 0.0) -> None:
        """See what others have taken and finished, unless the last look is recent."""
        with self._lock:
            if self._clock() - self._looked >= at_most_every:
                self.attempts.look()
                self._looked, self._is_stale = self._clock(), False

    def standing(self, chunk: str) -> Standing:
        """What can be done with a chunk, as of the last look."""
        with self._lock:
            if chunk in self.attempts.complete:
                return Standing.DONE
            if chunk in self.attempts.failed:
                return Standing.FAILED
            if chunk in self._mine:
                return Standing.HELD
            number = self.attempts.newest.get(chunk, 0)
            return Standing.FREE if not number or self._has_ended(chunk, number) else Standing.HELD

    def is_alive(self, chunk: str) -> bool:
        """Whether this process has seen a new heartbeat of the other process that holds a chunk."""
        number = self.attempts.newest.get(chunk, 0)
        try:
            lease = self.attempts.lease(chunk, number)
        except ResultsError:
            return False
        return lease is not None and self._seen.get(lease.owner, (0, 0.0, False))[2]

    def is_stolen(self, chunk: str) -> bool:
        """Whether another process has taken over a chunk of this one."""
        return chunk in self._stolen

    def take(self, chunk: str) -> ChunkFolder | None:
        """Take a chunk: a new attempt, with everything that earlier ones have committed.

        Returns:
            The folder of the attempt; None if the chunk is done, has failed, or belongs to another process.

        Raises:
            ResultsError: The folder cannot be written, or a committed file is missing or has changed.
        """
        with self._lock:
            if self._is_stale:
                self.look(at_most_every=min(1.0, self._seconds / BEATS))
            if self.standing(chunk) is not Standing.FREE:
                return None
            last = self.attempts.newest.get(chunk, 0)
            path = self.attempts.path(chunk, last + 1)
            with explained(path):
                try:
                    path.mkdir()
                except FileExistsError:
                    self._is_stale = True
                    self.attempts.newest[chunk] = last + 1
                    return None
            self.attempts.newest[chunk] = self._mine[chunk] = last + 1
            self._stolen.discard(chunk)
        return self._begin(chunk, last)

    def finish(self, chunk: str, facts: Mapping[str, Any]) -> None:
        """Note that a chunk of this process is done, with facts about it."""
        self._end(chunk, "done", facts)

    def fail(self, chunk: str, error: str) -> None:
        """Note that a chunk of this process has failed, and why."""
        self._end(chunk, "failed", {"error": error})

    def give_back(self, chunk: str) -> None:
        """Give back the lease of a chunk of this process; another one may go on from the last commit."""
        with self._lock:
            number = self._mine.pop(chunk, None)
        if number is None:
            return
        try:
            lease = self.attempts.lease(chunk, number)
            if lease is not None:
                self._write(chunk, number, Lease(**{**asdict(lease), "is_released": True}))
        except ResultsError:  # the lease ends with the heartbeats
            return

    def _begin(self, chunk: str, last: int) -> ChunkFolder | None:
        try:
            before = self._last_lease(chunk, last)
            found = self.attempts.committed(chunk, self._results) if last else None
            parts = found.state.parts if found else 0
            losses = 0
            if before is not None and not before.is_released and before.launch == self._launch:
                losses = before.losses + 1 if parts == before.parts else 1
            self._write(chunk, last + 1, Lease(self.owner, self._launch, parts, losses))
            if losses == MOST_LOSSES:
                self.fail(chunk, f"{losses} workers were lost, one after the other, while they ran it")
                return None
            files = ChunkFolder(self.attempts.path(chunk, last + 1), self._results, chunk)
            while found is not None and not files.inherit(found):
                found = self.attempts.committed(chunk, self._results)
            if found is not None and before is not None and before.is_released:
                shutil.rmtree(found.path, ignore_errors=True)  # nobody writes there any more
            if files.state.is_done:  # its owner was lost before it could say so
                self.finish(chunk, {})
                return None
            return files
        except BaseException:
            self.give_back(chunk)
            raise

    def _last_lease(self, chunk: str, last: int) -> Lease | None:
        try:
            return self.attempts.lease(chunk, last) if last else None
        except ResultsError:
            return None

    def _end(self, chunk: str, kind: str, content: Mapping[str, Any]) -> None:
        with self._lock:
            number = self._mine.pop(chunk)
        self.attempts.mark(chunk, number, kind, {"owner": self.owner, **content})
        with self._lock:
            (self.attempts.complete if kind == "done" else self.attempts.failed)[chunk] = number

    def _write(self, chunk: str, number: int, lease: Lease) -> None:
        write_json(self.attempts.path(chunk, number) / _LEASE, asdict(lease), durably=False)

    def _has_ended(self, chunk: str, number: int) -> bool:
        """Whether the lease of an attempt of another process has ended."""
        if (chunk, number) in self._ended:
            return True
        try:
            lease = self.attempts.lease(chunk, number)
            if lease is not None:
                has_ended = self._is_over(lease)
            else:  # it has just begun, its owner was lost at that moment, or its folder was deleted
                path = self.attempts.path(chunk, number)
                has_ended = not os.path.lexists(path) or self._is_silent(path.name, 0)
        except ResultsError:  # damaged: files appear complete, so this is no moment in between
            has_ended = True
        if has_ended:
            self._ended.add((chunk, number))
        return has_ended

    def _is_over(self, lease: Lease) -> bool:
        if lease.is_released:
            return True
        heartbeat = self.attempts.heartbeat(lease.owner)
        if heartbeat is None or is_gone(heartbeat.process):
            return True
        if self._is_driver and heartbeat.is_driver and heartbeat.launch < self._launch:
            return True
        return self._is_silent(lease.owner, heartbeat.beats)

    def _is_silent(self, name: str, beats: int) -> bool:
        """Whether a counter has not changed for too long, by the clock of this process."""
        now = self._clock()
        last, since, _ = self._seen.get(name, (beats, now, False))
        if name not in self._seen or beats != last:
            self._seen[name] = (beats, now, beats != last)
            return False
        return now - since >= self._seconds


def process_identity(pid: int) -> list[str] | None:
    """The system, the set of process numbers, the number and the start of a process; None if unknown.

    Process numbers are used again, and containers on one machine have their own.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return [boot, os.readlink("/proc/self/ns/pid"), str(pid), fields[19]]
    except OSError:
        return None


def is_gone(process: list[str] | None) -> bool:
    """Whether a process of this machine has ended; False for processes of other machines."""
    here = process_identity(os.getpid())
    if process is None or here is None or process[:2] != here[:2]:
        return False
    return process_identity(int(process[2])) != process


def _last(outcomes: list[tuple[str, int]], folders: Mapping[str, set[int]]) -> dict[str, int]:
    found: dict[str, int] = {}
    for chunk, number in outcomes:
        if number in folders.get(chunk, ()):
            found[chunk] = max(found.get(chunk, 0), number)
    return found


def _read(path: Path, kind: type) -> Any:
    """An object in a JSON file; None if there is no file."""
    if not os.path.lexists(path):
        return None
    try:
        return pydantic.TypeAdapter(kind).validate_python(read_json(path))
    except pydantic.ValidationError as error:
        raise ResultsError(f"{path}: damaged") from error
