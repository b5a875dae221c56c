"""A sweep's results folder: created without overwriting anything, locked, found again, resumed."""

import fcntl
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bojax.results.parts import ChunkFolder
from bojax.results.store import MANIFEST, WORK, ResultsError, explained, read_json, read_manifest, write_json

ROOT = Path("results")
_PLAN = "plan.json"
_LOCK = "lock"
_ASKED_FOR = ("runs", "seed", "record", "config", "points")
"""Keys of a plan that say what is run; the others say with what."""


class RunFolder:
    """The results folder of one sweep while it is written.

    The plan is what the results depend on: a resumed sweep must have the same one, or its parts would
    be of two kinds.
    """

    def __init__(self, path: Path):
        self.path = path
        self.work = path / WORK
        self._lock = None

    def create(self, plan: Mapping[str, Any]) -> None:
        """Make the folder and its working folder; nothing in it may exist yet."""
        with explained(self.path):
            self.work.mkdir(parents=True)
        self._take_lock()
        write_json(self.work / _PLAN, plan)

    def resume(self, plan: Mapping[str, Any]) -> None:
        """Take the folder up again, or raise a `ResultsError` that names what has changed."""
        self._take_lock()
        if not (self.work / _PLAN).exists():  # cut off while it was created
            write_json(self.work / _PLAN, plan)
        check_plan(self.path, read_json(self.work / _PLAN), plan)

    def chunk(self, name: str) -> ChunkFolder:
        """The working folder of a chunk."""
        return ChunkFolder(self.work / name)

    def note(self, name: str, content: Any) -> None:
        """Keep a small JSON file beside the chunks."""
        write_json(self.work / f"{name}.json", content)

    def noted(self, name: str, default: Any) -> Any:
        """What `note` kept, or the default."""
        path = self.work / f"{name}.json"
        return read_json(path) if path.exists() else default

    def close(self, *, finished: bool) -> None:
        """Release the folder; delete the working files of a finished sweep."""
        if finished:
            # Renamed first: a process killed while it deletes leaves no half of a working folder behind.
            done = self.work.with_name(f"{WORK}-done")
            os.replace(self.work, done)
            shutil.rmtree(done, ignore_errors=True)
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _take_lock(self) -> None:
        with explained(self.work):
            self._lock = (self.work / _LOCK).open("w")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ResultsError(f"{self.path}: another process is writing to this folder") from None


def choose_folder(name: str, out: Path | None, *, resume: bool) -> tuple[Path, bool]:
    """Where results go, and whether there is something to resume there.

    Args:
        name: Name of the sweep.
        out: A folder given by the user; otherwise `results/<name>/<timestamp>`.
        resume: Whether to go on with an unfinished sweep: in `out`, or in the newest folder that has one.

    Raises:
        ResultsError: the folder exists and holds something, or there is nothing to resume.
    """
    if out is None and resume:
        return _newest_unfinished(ROOT / name), True
    if out is None:
        return _fresh(ROOT / name / time.strftime("%Y%m%d-%H%M%S")), False
    if not out.exists():
        return out, False
    if not out.is_dir():
        raise ResultsError(f"{out}: not a folder: give --out a new one")
    if resume and (is_unfinished(out) or (out / MANIFEST).exists()):
        return out, True
    with explained(out):
        is_empty = not any(out.iterdir())
    if not is_empty:
        raise ResultsError(
            f"{out}: the folder is not empty: give a new --out, or --resume an unfinished sweep"
        )
    return out, False


def is_unfinished(folder: Path) -> bool:
    """Whether a sweep in this folder was interrupted, or had a chunk that failed."""
    return (folder / WORK).is_dir()


def check_plan(folder: Path, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Raise a `ResultsError` that names the first differences of two plans, if there are any."""
    # A change of the base config is one of every point too: say it once.
    found: dict[str, str] = {}
    for line in _changes(old, new):
        found.setdefault(line.rpartition("config.")[2], line)
    changes = list(found.values())
    if changes:
        more = f" and {len(changes) - 3} more" if len(changes) > 3 else ""
        listed = ", ".join(changes[:3]) + more
        raise ResultsError(
            f"{folder}: cannot resume, the sweep has changed: {listed}: undo it, or give a new --out"
        )


def check_finished(folder: Path, plan: Mapping[str, Any]) -> None:
    """Raise a `ResultsError` unless a finished folder holds what this plan asks for.

    By what code and on which device is not compared: nothing would be mixed.
    """
    old = read_manifest(folder).get("plan", {})
    check_plan(folder, *({key: found.get(key) for key in _ASKED_FOR} for found in (old, plan)))


def _newest_unfinished(root: Path) -> Path:
    folders = sorted(root.iterdir()) if root.is_dir() else []
    for folder in reversed(folders):
        if is_unfinished(folder):
            return folder
    raise ResultsError(f"{root}: no unfinished sweep to resume: leave --resume out to start one")


def _fresh(path: Path) -> Path:
    candidate, number = path, 2
    while candidate.exists():
        candidate, number = path.with_name(f"{path.name}-{number}"), number + 1
    return candidate


def _changes(old: Any, new: Any, path: str = ""):
    """Lines `dotted.path: old -> new` for every difference of two trees of plain values."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in [*old, *(key for key in new if key not in old)]:
            dotted = f"{path}.{key}" if path else str(key)
            yield from _changes(old.get(key), new.get(key), dotted)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from _changes(before, after, f"{path}.{index}")
    elif old != new:
        yield f"{path}: {_short(old)} -> {_short(new)}"


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
