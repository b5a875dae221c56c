"""Attempts at chunks: each writes into a folder of its own, so that no two processes write the same files.

A chunk has one owner in a launch. An owner that is started again, or the next launch, begins a new attempt,
with everything that earlier attempts have committed. A process that was paused and wakes up late still writes
into the folder of its own attempt, where it does no harm: merging takes the newest complete attempt. In the
working folder are:

- `<chunk>-<number>/`: the files of an attempt, made by `mkdir`, which succeeds for one process alone, also
  on NFS;
- `<chunk>-<number>/attempt.json`: who began it, written once;
- `<chunk>-<number>.done`, `.failed`, `.paused`: how it ended. An owner that was lost leaves no such file.
"""

import contextlib
import os
import re
import shutil
import socket
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import pydantic

from bojax.results.chunk_folder import ChunkFolder
from bojax.results.store import ResultsError, explained, read_json, remove, write_json

MOST_LOSSES = 2
"""Number of owners that a chunk may lose in a launch, in succession and without a commit, before it fails."""

_NAME = re.compile(
    r"(?P<chunk>chunk-\d{5,}-[0-9a-f]{12})-(?P<number>\d+)(?:\.(?P<ending>done|failed|paused))?"
)
_ATTEMPT = "attempt.json"

Ending = Literal["done", "failed", "paused"]


@dataclass(frozen=True)
class Attempt:
    """Who began an attempt."""

    launch: str  # identifies the launch
    host: str  # name of the machine
    process: list[str] | None  # identifies the process on its machine; None if unknown
    pieces: int = 0  # number of pieces that earlier attempts had committed
    # Number of owners that the chunk had lost in this launch, in succession and without a commit
    losses: int = 0

    @property
    def owner(self) -> str:
        """The process as `HOST-PID`."""
        return f"{self.host}-{self.process[2] if self.process else 'unknown'}"


class AttemptRegistry:
    """The attempts at the chunks of a sweep, as of the last `look`; safe to use from several threads."""

    def __init__(self, work: Path, results: Path):
        self._work, self._results = work, results
        self._numbers: dict[str, set[int]] = {}
        self._ended: dict[str, dict[str, int]] = {"done": {}, "failed": {}, "paused": {}}
        self._lock = threading.RLock()
        self.look()

    @property
    def done(self) -> Mapping[str, int]:
        """Number of the newest complete attempt at each chunk that has one."""
        return self._ended["done"]

    @property
    def failed(self) -> Mapping[str, int]:
        """Number of the newest failed attempt at each chunk that has one."""
        return self._ended["failed"]

    @property
    def paused(self) -> Mapping[str, int]:
        """Number of the newest attempt at each chunk that its owner has stopped at a checkpoint."""
        return self._ended["paused"]

    def look(self) -> None:
        """List the folder. The ending of an attempt whose folder was deleted does not count.

        Raises:
            ResultsError: The folder is gone, or cannot be read.
        """
        with explained(self._work, "read"):
            names = set(os.listdir(self._work))
        numbers: dict[str, set[int]] = {}
        ended: dict[str, dict[str, int]] = {"done": {}, "failed": {}, "paused": {}}
        for name in names:
            if match := _NAME.fullmatch(name):
                chunk, number, ending = match["chunk"], int(match["number"]), match["ending"]
                numbers.setdefault(chunk, set()).add(number)  # a number is never used twice
                if ending and name.removesuffix(f".{ending}") in names:
                    ended[ending][chunk] = max(number, ended[ending].get(chunk, 0))
        with self._lock:
            self._numbers, self._ended = numbers, ended

    def newest(self, chunk: str) -> int:
        """Number of the newest attempt at a chunk; 0 before the first."""
        return max(self._numbers.get(chunk, ()), default=0)

    def begun(self) -> list[str]:
        """The chunks that have an attempt."""
        return list(self._numbers)

    def has_ended(self, chunk: str) -> bool:
        """Whether a chunk is done or has failed."""
        return chunk in self.done or chunk in self.failed

    def path(self, chunk: str, number: int) -> Path:
        """The folder of an attempt."""
        return self._work / f"{chunk}-{number}"

    def attempt(self, chunk: str, number: int) -> Attempt | None:
        """Who began an attempt; None if unknown."""
        try:
            content = read_json(self.path(chunk, number) / _ATTEMPT)
            return pydantic.TypeAdapter(Attempt).validate_python(content)
        except (ResultsError, pydantic.ValidationError):
            return None  # the owner was lost while it wrote the file, or the file is damaged

    def note(self, chunk: str, ending: Ending) -> dict[str, Any]:
        """What was noted at the newest ending of a kind; empty if it is damaged."""
        try:
            content = read_json(self._marker(chunk, self._ended[ending][chunk], ending))
        except ResultsError:
            return {}
        return content if isinstance(content, dict) else {}

    def reason(self, chunk: str) -> str:
        """Why the newest failed attempt at a chunk failed, in one line."""
        return str(self.note(chunk, "failed").get("error", "for a reason that is damaged"))

    def committed(self, chunk: str) -> ChunkFolder | None:
        """The files of a chunk: of the newest complete attempt, or else of the newest one with a commit."""
        numbers = sorted(self._numbers.get(chunk, ()), reverse=True)
        if chunk in self.done:
            numbers = [self.done[chunk], *numbers]
        for number in numbers:
            files = ChunkFolder(self.path(chunk, number), self._results, chunk)
            if files.read():
                return files
        return None

    def begin(self, chunk: str, launch: str) -> ChunkFolder | None:
        """Begin an attempt, with all that earlier ones have committed; None if the chunk has ended.

        The caller is the owner of the chunk in this launch. An earlier attempt in the same launch that did
        not end therefore means that the owner was lost.

        Raises:
            ResultsError: The folder cannot be written, or a committed file is missing or has changed.
        """
        number = self._make(chunk)
        if number is None:
            return None
        before = max((each for each in self._numbers[chunk] if each < number), default=0)
        files = ChunkFolder(self.path(chunk, number), self._results, chunk)
        try:
            found = self.committed(chunk)
            pieces = found.state.pieces if found else 0
            losses, is_paused = 0, self.paused.get(chunk) == before
            last, here = self.attempt(chunk, before), process_identity(os.getpid())
            # A worker that somebody starts beside another one repeats its chunks; the other one is not lost.
            is_other = last is not None and last.process != here and is_gone(last.process) is False
            if last is not None and last.launch == launch and not is_paused and not is_other:
                # A chunk that makes progress does not kill its owners: after a commit, counting begins anew.
                losses = last.losses + 1 if last.pieces == pieces else 1
            own = Attempt(launch, socket.gethostname(), here, pieces, losses)
            write_json(files.path / _ATTEMPT, asdict(own), durably=False)
            if losses == MOST_LOSSES:
                self.end(
                    files, "failed", {"error": f"{losses} workers were lost in succession while they ran it"}
                )
                return None
            # A process of an earlier launch may still run, commit, and delete the files that it replaces.
            while found is not None and not files.inherit(found):
                found = self.committed(chunk)
            if found is not None and is_paused and found.path == self.path(chunk, before):
                shutil.rmtree(found.path, ignore_errors=True)  # nobody writes there any more
            if files.state.is_done:  # its owner was lost before it could say so
                self.end(files, "done", {})
                return None
            return files
        except BaseException:
            with contextlib.suppress(ResultsError):  # paused, since it does not count as a lost owner
                self.end(files, "paused", {})
            raise

    def _make(self, chunk: str) -> int | None:
        """Make the folder of the next attempt; None if the chunk has ended."""
        with self._lock:
            while not self.has_ended(chunk):
                number = self.newest(chunk) + 1
                self._numbers.setdefault(chunk, set()).add(number)
                path = self.path(chunk, number)
                with explained(path):
                    try:
                        path.mkdir()
                        return number
                    except FileExistsError:  # of a process of an earlier launch that still runs
                        taken = self._numbers[chunk]
                self.look()
                self._numbers.setdefault(chunk, set()).update(taken)  # a mount may show the folder later
            return None

    def end(self, files: ChunkFolder, ending: Ending, content: Mapping[str, Any]) -> None:
        """Note how an attempt of this process ended."""
        chunk, _, number = files.path.name.rpartition("-")
        write_json(self._marker(chunk, int(number), ending), content, durably=False)
        with self._lock:
            self._ended[ending][chunk] = int(number)

    def forget(self, chunk: str, ending: Ending) -> None:
        """Forget how a chunk ended."""
        path = self._marker(chunk, self._ended[ending].pop(chunk), ending)
        with explained(path, "deleted"):
            remove(path)  # a damaged one may be a folder

    def _marker(self, chunk: str, number: int, ending: Ending) -> Path:
        return self._work / f"{chunk}-{number}.{ending}"


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


def is_gone(process: list[str] | None) -> bool | None:
    """Whether a process of this machine has ended; None for processes of other machines."""
    here = process_identity(os.getpid())
    if process is None or here is None or process[:2] != here[:2]:
        return None
    return process_identity(int(process[2])) != process
