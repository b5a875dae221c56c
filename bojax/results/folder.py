"""The results folder of a sweep: choosing, creating, locking and resuming it without overwriting results."""

import contextlib
import fcntl
import os
import secrets
import shutil
import socket
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bojax.results.store import (
    MANIFEST,
    WORK,
    ResultsError,
    explained,
    publish_checked_json,
    read_checked_json,
    read_json,
    read_manifest,
    sync,
    write_checked_json,
    write_json,
)

ROOT = Path("results")
_PLAN = "plan.json"
_LAUNCH = "launch.json"
_DEVICE = "device.json"
_LOCK = "lock"
_COMPILED = "compiled-{}.json"  # for each process
_DONE = f"{WORK}-done"
_ASKED_FOR = ("runs", "seed", "record", "config", "points")
"""Keys of a plan that define the runs; the others describe the code, the versions and the device."""


@dataclass(frozen=True)
class Launch:
    """What a worker needs to know of a sweep."""

    identity: str  # identifies the launch: the start of the sweep, or one resumption
    folder: str  # the working directory of the command, where files and modules of the sweep are looked up
    sweep: dict[str, Any]  # as plain values
    # Indices of the chunks that are divided among the workers of the launch; None for all
    left: list[int] | None = None


class NothingToResume(ResultsError):
    """A sweep has no unfinished folder."""


class RunFolder:
    """The results folder of a sweep that is running.

    The plan is everything that the results depend on. A sweep can only be resumed with the same plan.
    """

    def __init__(self, path: Path):
        self.path = path  # `create` may change its name
        self._lock = None

    @property
    def work(self) -> Path:
        """The working folder, which holds the chunks."""
        return self.path / WORK

    @property
    def choices(self) -> Path:
        """The folder of the choices that XLA made for the programs of the plan."""
        return self.work / "choices"

    def create(self, plan: Mapping[str, Any] | None, *, may_rename: bool = False) -> None:
        """Make the folder and its working folder, with the plan unless a worker makes it.

        With `may_rename`, a number is appended to the name if the folder exists, because another sweep
        started in the same second.
        """
        with explained(self.path):
            if may_rename:
                self.path = make_new(self.path)
            try:
                self.work.mkdir(parents=True)
            except FileExistsError:
                raise self._in_use() from None
        self._take_lock()
        if plan is not None:
            write_checked_json(self.work / _PLAN, plan)

    def resume(self, plan: Mapping[str, Any]) -> None:
        """Reopen the folder, or raise a `ResultsError` that names the changes of the plan."""
        self._take_lock()
        old = self.plan()
        if old is None:  # interrupted while the folder was created
            write_checked_json(self.work / _PLAN, plan)
        else:
            check_plan(self.path, old, plan)

    def plan(self) -> dict[str, Any] | None:
        """The plan; None if no process has written it yet."""
        path = self.work / _PLAN
        if not os.path.lexists(path):
            return None
        try:
            return read_checked_json(path)
        except ResultsError as error:
            # Chunks stay valid: the name of a chunk's folder is a hash of everything that its rows depend on.
            message = f"{path}: damaged: delete this file and resume; pieces of another sweep are not used"
            raise ResultsError(message) from error

    def join(self, plan: Mapping[str, Any], device: Mapping[str, Any]) -> None:
        """Commit a worker's plan, or raise a `ResultsError` if it differs from the one that is there.

        `device` describes the worker's devices, which `RunFolder.device` then returns.
        """
        if self.plan() is None:
            self.describe(device)
            publish_checked_json(self.work / _PLAN, plan)
        check_plan(
            self.path,
            self.plan() or {},
            plan,
            what="this worker does not fit the plan",
            advice="allowed: the same versions, on a device of the same kind",
        )

    def describe(self, device: Mapping[str, Any]) -> None:
        """Write the description of the devices of the process that makes the plan, or of a worker."""
        path = self.work / _DEVICE
        own = path.with_name(f".{_DEVICE}-{secrets.token_hex(6)}")  # workers may write side by side
        write_checked_json(own, device, _DEVICE)
        with explained(path):
            own.replace(path)

    def device(self) -> dict[str, Any]:
        """The description that `describe` wrote, for a driver on a machine that may have no such device."""
        return read_checked_json(self.work / _DEVICE)

    def launch(self, sweep: Mapping[str, Any], left: Sequence[int] | None = None) -> Launch:
        """Write what workers need to know of the sweep, and which chunks they divide among them."""
        chunks = None if left is None else list(left)
        launch = Launch(secrets.token_hex(6), str(Path.cwd()), dict(sweep), chunks)
        path = self.work / _LAUNCH
        if path.is_dir() and not path.is_symlink():  # damaged
            shutil.rmtree(path, ignore_errors=True)
        write_checked_json(path, asdict(launch))
        return launch

    def launched(self) -> Launch:
        """What `launch` wrote.

        Raises:
            ResultsError: There is nothing, or it is damaged.
        """
        path = self.work / _LAUNCH
        if not self.work.is_dir():
            what = "no unfinished sweep in this folder" if self.path.is_dir() else "no such folder"
            raise ResultsError(
                f"{self.path}: {what} on {socket.gethostname()}; allowed: the "
                "results folder of a sweep, at the same path on all machines"
            )
        try:
            return Launch(**read_checked_json(path))
        except (ResultsError, TypeError) as error:
            raise ResultsError(f"{path}: missing or damaged; start the sweep again with --resume") from error

    def note_compiled(self, process: str, seconds: Mapping[int, float]) -> None:
        """Write the seconds that a process has spent on compiling each group."""
        write_json(self.work / _COMPILED.format(process), dict(seconds), durably=False)

    def compile_seconds(self) -> dict[str, float]:
        """Seconds of compilation of all processes, by index of the group."""
        total: dict[str, float] = defaultdict(float)
        for path in self.work.glob(_COMPILED.format("*")):
            with contextlib.suppress(ResultsError, ValueError, TypeError, AttributeError):  # a damaged file
                for group, seconds in read_json(path).items():
                    total[group] += float(seconds)
        return total

    def programs(self) -> dict[str, str]:
        """The hashes of the programs of the plan, by name, as in `manifest.json`."""
        paths = sorted(self.choices.glob("[!.]*.json"))
        return {path.stem: read_checked_json(path)["program"][:16] for path in paths}

    def close(self, *, finished: bool) -> None:
        """Release the folder; delete the working files of a finished sweep."""
        if finished:
            with explained(self.path):
                sync(self.path, *(path for path in self.path.iterdir() if path.is_dir()))
                drop_leftovers(self.path)
                # Renaming is atomic: a process killed during the deletion leaves no partial working folder.
                os.replace(self.work, self.path / _DONE)
            drop_leftovers(self.path)
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _take_lock(self) -> None:
        with explained(self.work):
            self._lock = (self.work / _LOCK).open("a+")  # opening a pipe only for writing would block
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise self._in_use() from None

    def _in_use(self) -> ResultsError:
        return ResultsError(f"{self.path}: another process is writing to this folder")


def choose_folder(name: str, out: Path | None, *, resume: bool) -> tuple[Path, bool]:
    """The results folder, and whether an unfinished sweep is resumed in it.

    It is the given one, or else a new `results/<name>/<timestamp>`, or the newest unfinished one to `resume`.

    Raises:
        NothingToResume: There is no unfinished sweep.
        ResultsError: The folder is not empty, or lies in the results folder of another sweep.
    """
    if out is None and resume:
        return _newest_unfinished(ROOT / name), True
    if out is None:
        return dated_folder(name), False
    if resume and os.path.isdir(out) and (is_unfinished(out) or os.path.lexists(out / MANIFEST)):
        return out, True
    require_empty(out, "give another --out, or --resume an unfinished sweep")
    for above in out.absolute().parents:
        if os.path.lexists(above / MANIFEST):
            raise ResultsError(f"{out}: lies in the results of another sweep, {above}; give another --out")
    return out, False


def reserve_folder(name: str, out: Path | None, *, resume: bool) -> tuple[Path, bool]:
    """The same, and the folder `results/<name>/<timestamp>` is made, so that no other process takes it."""
    folder, is_resumed = choose_folder(name, out, resume=resume)
    if out is None and not is_resumed:
        with explained(folder):
            folder = make_new(folder)
    return folder, is_resumed


def make_new(path: Path) -> Path:
    """Make a folder and return it; a number is appended to its name if there is one of this name."""
    made, number = path, 2
    while True:
        try:
            made.mkdir(parents=True)
            return made
        except FileExistsError:
            made, number = path.with_name(f"{path.name}-{number}"), number + 1


def dated_folder(name: str) -> Path:
    """The folder `results/<name>/<timestamp>`."""
    return ROOT / name / time.strftime("%Y%m%d-%H%M%S")


def require_empty(folder: Path, advice: str = "give another --out") -> None:
    """Raise a `ResultsError` unless a folder is new or empty."""
    if not os.path.lexists(folder):
        return
    if not os.path.isdir(folder):
        raise ResultsError(f"{folder}: is not a folder; allowed: a new or empty folder")
    with explained(folder, "read"):
        is_empty = not any(folder.iterdir())
    if not is_empty:
        raise ResultsError(f"{folder}: the folder is not empty; {advice}")


def drop_leftovers(folder: Path) -> None:
    """Delete the working files of a finished sweep that a killed process left behind."""
    shutil.rmtree(folder / _DONE, ignore_errors=True)


def is_unfinished(folder: Path) -> bool:
    """Whether the sweep in a folder was interrupted or has a failed chunk."""
    return os.path.isdir(folder / WORK)


def check_plan(
    folder: Path,
    old: Mapping[str, Any],
    new: Mapping[str, Any],
    *,
    what: str = "cannot resume, its plan has changed",
    advice: str = "undo this, or give another --out",
) -> None:
    """Raise a `ResultsError` with the first differences of two plans, if they differ."""
    # A change of the base config is also a change of every point, and reported once.
    found: dict[str, str] = {}
    for line in _changes(old, new):
        found.setdefault(line.rpartition("config.")[2], line)
    if changes := list(found.values()):
        more = f" and {len(changes) - 3} more" if len(changes) > 3 else ""
        raise ResultsError(f"{folder}: {what}: {', '.join(changes[:3])}{more}; {advice}")


def check_finished(folder: Path, plan: Mapping[str, Any]) -> None:
    """Raise a `ResultsError` unless the sweep in a folder is finished and has the runs of this plan.

    Code, versions and devices are not compared, since no further run is added.
    """
    manifest = read_manifest(folder)
    old, status = manifest.get("plan"), manifest.get("status")
    if status != "finished":
        raise ResultsError(
            f"{folder}: cannot resume: the status is {status}, but the working folder {WORK} is missing; "
            "give another --out"
        )
    if not isinstance(old, Mapping):
        raise ResultsError(f"{folder / MANIFEST}: plan: got a {type(old).__name__}; allowed: a mapping")
    check_plan(folder, *({key: found.get(key) for key in _ASKED_FOR} for found in (old, plan)))


def _newest_unfinished(root: Path) -> Path:
    with explained(root, "read"):
        folders = sorted(root.iterdir()) if os.path.isdir(root) else []
    for folder in reversed(folders):
        if is_unfinished(folder):
            return folder
    raise NothingToResume(f"{root}: no unfinished sweep to resume; to start a sweep, leave out --resume")


def _changes(old: Any, new: Any, path: str = ""):
    """A line `dotted.path: old -> new` for every difference of two trees of values; hashes are left out."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in [*old, *(key for key in new if key not in old)]:
            yield from _changes(old.get(key), new.get(key), f"{path}.{key}" if path else str(key))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from _changes(before, after, f"{path}.{index}")
    elif old != new:
        is_hash = path.startswith("code.")
        yield f"{path}: {'the source differs' if is_hash else f'{_short(old)} -> {_short(new)}'}"


def _short(value: Any) -> str:
    text = str(value)
    if len(text) <= 60:
        return text
    return f"a list of {len(value)}" if isinstance(value, list) else f"{text[:57]}..."
