"""A sweep's results folder: created without overwriting anything, locked, found again, resumed."""

import fcntl
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bojax.results.parts import ChunkFolder
from bojax.results.store import (
    MANIFEST,
    WORK,
    ResultsError,
    explained,
    read_checked_json,
    read_manifest,
    sync,
    write_checked_json,
)

ROOT = Path("results")
_PLAN = "plan.json"
_LOCK = "lock"
_DONE = f"{WORK}-done"
_ASKED_FOR = ("runs", "seed", "record", "config", "points")
"""Keys of a plan that say what is run; the others say with what."""


class RunFolder:
    """The results folder of one sweep while it is written.

    The plan is what the results depend on: a resumed sweep must have the same one, or its parts would
    be of two kinds.

    Attributes:
        path: The folder; `create` may have to choose another name.
    """

    def __init__(self, path: Path):
        self.path = path
        self._lock = None

    @property
    def work(self) -> Path:
        """Its working folder."""
        return self.path / WORK

    def create(self, plan: Mapping[str, Any], *, may_rename: bool = False) -> None:
        """Make the folder and its working folder.

        Args:
            plan: The plan.
            may_rename: Whether to append a number to the folder's name if there is such a folder already,
                which another sweep may have made in the same second.
        """
        with explained(self.path):
            if may_rename:
                self._make_new()
            try:
                self.work.mkdir(parents=True)
            except FileExistsError:
                raise self._in_use() from None
        self._take_lock()
        write_checked_json(self.work / _PLAN, plan)

    def resume(self, plan: Mapping[str, Any]) -> None:
        """Take the folder up again, or raise a `ResultsError` that names what has changed."""
        self._take_lock()
        path = self.work / _PLAN
        if not os.path.lexists(path):  # cut off while it was created
            write_checked_json(path, plan)
        try:
            old = read_checked_json(path)
        except ResultsError as error:
            # The name of a chunk's folder is a hash of all that its rows depend on.
            message = f"{path}: damaged: delete this file and resume: parts of another sweep are not taken up"
            raise ResultsError(message) from error
        check_plan(self.path, old, plan)

    def chunk(self, name: str) -> ChunkFolder:
        """The working folder of a chunk."""
        return ChunkFolder(self.work / name, self.path)

    def note(self, name: str, content: Any) -> None:
        """Keep a small JSON file beside the chunks."""
        write_checked_json(self.work / f"{name}.json", {name: content})

    def noted(self, name: str, default: Any) -> Any:
        """What `note` kept, or the default if there is nothing or the file is damaged."""
        path = self.work / f"{name}.json"
        try:
            return read_checked_json(path).get(name, default)
        except ResultsError:
            if path.is_dir() and not path.is_symlink():  # a file could not be written in its place
                shutil.rmtree(path, ignore_errors=True)
            return default

    def close(self, *, finished: bool) -> None:
        """Release the folder; delete the working files of a finished sweep."""
        if finished:
            with explained(self.path):
                sync(self.path, *(path for path in self.path.iterdir() if path.is_dir()))
                drop_leftovers(self.path)
                # Renamed first: a process killed while it deletes leaves no half of a working folder behind.
                os.replace(self.work, self.path / _DONE)
            drop_leftovers(self.path)
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _make_new(self) -> None:
        first, number = self.path, 2
        while True:
            try:
                self.path.mkdir(parents=True)
                return
            except FileExistsError:
                self.path, number = first.with_name(f"{first.name}-{number}"), number + 1

    def _take_lock(self) -> None:
        with explained(self.work):
            self._lock = (self.work / _LOCK).open("a+")  # to open a pipe for writing alone would wait
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise self._in_use() from None

    def _in_use(self) -> ResultsError:
        return ResultsError(f"{self.path}: another process is writing to this folder")


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
        return ROOT / name / time.strftime("%Y%m%d-%H%M%S"), False
    if not os.path.lexists(out):
        return out, False
    if not os.path.isdir(out):
        raise ResultsError(f"{out}: not a folder: give --out a new one")
    if resume and (is_unfinished(out) or os.path.lexists(out / MANIFEST)):
        return out, True
    with explained(out, "read"):
        is_empty = not any(out.iterdir())
    if not is_empty:
        raise ResultsError(
            f"{out}: the folder is not empty: give a new --out, or --resume an unfinished sweep"
        )
    return out, False


def drop_leftovers(folder: Path) -> None:
    """Delete the working files of a finished sweep that a killed process has left."""
    shutil.rmtree(folder / _DONE, ignore_errors=True)


def is_unfinished(folder: Path) -> bool:
    """Whether a sweep in this folder was interrupted, or had a chunk that failed."""
    return os.path.isdir(folder / WORK)


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
    """Raise a `ResultsError` unless the sweep in a folder is finished and is what this plan asks for.

    By what code and on which device is not compared: nothing would be mixed.
    """
    manifest = read_manifest(folder)
    old, status = manifest.get("plan"), manifest.get("status")
    if status != "finished":
        raise ResultsError(
            f"{folder}: cannot resume: its status is {status}, but its working folder {WORK} is gone: "
            "give a new --out"
        )
    if not isinstance(old, Mapping):
        raise ResultsError(f"{folder / MANIFEST}: plan: a mapping is expected, not a {type(old).__name__}")
    check_plan(folder, *({key: found.get(key) for key in _ASKED_FOR} for found in (old, plan)))


def _newest_unfinished(root: Path) -> Path:
    with explained(root, "read"):
        folders = sorted(root.iterdir()) if os.path.isdir(root) else []
    for folder in reversed(folders):
        if is_unfinished(folder):
            return folder
    raise ResultsError(f"{root}: no unfinished sweep to resume: leave --resume out to start one")


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
