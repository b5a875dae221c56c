"""A worker: a process that runs its share of the chunks of sweeps, started by hand or by a launcher.

Workers and driver share only the results folder. A worker makes the plan of the sweep from the settings in
the folder, for its own device. The first worker commits its plan; a worker whose plan differs ends.
"""

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import pydantic

from bojax.config.errors import say
from bojax.config.external import resolve
from bojax.config.points import Sweep
from bojax.config.saved_sweep import loaded
from bojax.engine.chunks import Chunk
from bojax.engine.devices import choose, find_devices, prepare
from bojax.engine.execute import execute
from bojax.engine.plan import make_plan
from bojax.engine.storage import FolderStorage
from bojax.engine.tasks import progress_of, tasks_of, workers_for
from bojax.errors import FAILURE, UserError
from bojax.results.attempts import AttemptRegistry
from bojax.results.folder import Launch, RunFolder
from bojax.results.store import ResultsError
from bojax.text import error_line

Item = TypeVar("Item")

EXPECTED = (UserError, ImportError)
"""Errors that the user can act on, printed as one line."""


def run_worker(
    folders: Sequence[Path],
    stop: Callable[[], bool],
    *,
    devices: Sequence[int] | None = None,
    cores: int | None = None,
    share: tuple[int, int] = (0, 1),
) -> int:
    """Run a share of the chunks; return 0, or 1 if a chunk failed here.

    After a requested stop, the chunks that run are paused at a checkpoint. Sweeps that have ended meanwhile
    are left out. `devices` and `cores` are what the worker uses of its machine, by default all; `share` is
    the number of its share, from 0, and that of all shares that the chunks of the launch are divided into.

    Raises:
        ConfigError: The sweep cannot be built on this machine.
        EngineError: There is no such device.
        ResultsError: No folder holds a planned sweep, or one belongs to another kind of device or to other
            versions, or cannot be written.
    """
    opened = [RunFolder(folder.absolute()) for folder in folders]
    left = [(index, folder) for index, folder in enumerate(opened) if folder.work.is_dir()]
    launches = [(index, folder, folder.launched()) for index, folder in left or [(0, opened[0])]]
    sweeps = [_sweep_of(folder, launch) for _, folder, launch in launches]
    prepare(sweeps[0].engine.device)
    found, (number, count) = choose(find_devices(sweeps[0].engine.device), devices), share
    owned: dict[FolderStorage, Sequence[Chunk]] = {}
    try:
        for (index, folder, launch), sweep in zip(launches, sweeps, strict=True):
            os.chdir(launch.folder)
            plan = make_plan(resolve(sweep), found)
            folder.join(plan.content, plan.device)
            storage = FolderStorage(plan, folder, launch, AttemptRegistry(folder.work, folder.path))
            chunks = plan.chunks if launch.left is None else [plan.chunks[chunk] for chunk in launch.left]
            owned[storage] = share_of(chunks, (number + index) % count, count)
        several = len(owned) > 1
        tasks = [
            task
            for storage, chunks in owned.items()
            for task in tasks_of(storage.plan, storage.unfinished(chunks), storage, name_sweep=several)
        ]
        workers = workers_for(tasks, found, cores)
        with progress_of(owned, tasks) as progress:
            for _ in execute(tasks, workers, progress, stop):
                pass
    except ResultsError as error:
        if not all(folder.work.is_dir() for _, folder, _ in launches):
            print("the sweep has ended", file=sys.stderr)
            return 0
        raise error
    return FAILURE if any(storage.failures for storage in owned) else 0


def share_of(chunks: Sequence[Item], number: int, count: int) -> Sequence[Item]:
    """The chunks of one of several shares, which differ by one chunk at most.

    They follow one another, so that all shares together compile `count - 1` groups more than once at most.
    """
    return chunks[number * len(chunks) // count : (number + 1) * len(chunks) // count]


def _sweep_of(folder: RunFolder, launch: Launch) -> Sweep:
    if not os.path.isdir(launch.folder):
        raise ResultsError(
            f"{folder.path}: the sweep was started in {launch.folder}, which this machine lacks; allowed: a "
            "working directory that all machines share"
        )
    try:
        return loaded(launch.sweep)
    except (pydantic.ValidationError, KeyError, TypeError) as error:
        reason = f"this version of bojax cannot read the sweep ({error_line(error)})"
        raise ResultsError(f"{folder.path}: {reason}") from error


def guarded(work: Callable[[], int]) -> int:
    """The exit code of a worker; an error that the user can act on becomes one line and the error's code."""
    try:
        return work()
    except EXPECTED as error:
        say(f"error: {error}")
        return error.exit_code if isinstance(error, UserError) else FAILURE
