"""A worker: a process that runs chunks of planned sweeps, started by hand or by a launcher on any machine.

Workers and driver share only the results folder. A worker makes the plan of the sweep from the settings in
the folder, for its own device. The first worker commits its plan; a worker whose plan differs ends.
"""

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pydantic

from bojax.config.errors import ConfigError, printable
from bojax.config.external import resolve
from bojax.config.saved_sweep import loaded
from bojax.config.sweep import Sweep
from bojax.engine.devices import choose, find_devices, prepare
from bojax.engine.errors import FAILURE, EngineError
from bojax.engine.execute import execute
from bojax.engine.plan import make_plan
from bojax.engine.share import FolderShare
from bojax.engine.tasks import progress_of, tasks_of, workers_for
from bojax.results.folder import Launch, RunFolder
from bojax.results.store import ResultsError
from bojax.text import error_line

EXPECTED = (ConfigError, ResultsError, EngineError, ImportError)
"""Errors that the user can act on, told in one line."""


@dataclass(frozen=True)
class WorkerOptions:
    """What a worker uses of its machine, and where it starts.

    Attributes:
        devices: Indices of the devices; None for all.
        cores: Number of cores of a CPU; None for all that the process may run on.
        number: Number of this worker among those of a launch, from 0.
        count: Number of workers of the launch.
        waits: Whether it stays while other workers run chunks, to take over chunks of lost workers.
    """

    devices: Sequence[int] | None = None
    cores: int | None = None
    number: int = 0
    count: int = 1
    waits: bool = False


def run_worker(folders: Sequence[Path], options: WorkerOptions, stop: Callable[[], bool]) -> int:
    """Run chunks until each has ended or is run by a living process; return 0, or 1 if a chunk failed here.

    After a requested stop, the chunks that run are paused at a checkpoint, and their leases are given back.

    Raises:
        ConfigError: The sweep cannot be built on this machine.
        EngineError: There is no such device.
        ResultsError: A folder is not that of a planned sweep, belongs to another kind of device or other
            versions, or cannot be written.
    """
    opened = [RunFolder(folder.absolute()) for folder in folders]
    launches = [folder.launched() for folder in opened]
    sweeps = [_sweep_of(folder, launch) for folder, launch in zip(opened, launches, strict=True)]
    prepare(sweeps[0].engine.device)
    devices = choose(find_devices(sweeps[0].engine.device), options.devices)
    shares: list[FolderShare] = []
    try:
        for folder, launch, sweep in zip(opened, launches, sweeps, strict=True):
            os.chdir(launch.folder)
            plan = make_plan(resolve(sweep), devices)
            folder.join(plan.content, plan.device)
            shares.append(FolderShare.join(plan, folder, launch))
        start = options.number / options.count
        several = len(shares) > 1
        tasks = [task for share in shares for task in tasks_of(share, stop, name_sweep=several, start=start)]
        workers = workers_for(tasks, devices, options.cores)
        with progress_of(shares, tasks) as progress:
            for _ in execute(tasks, workers, progress, stop, waits=options.waits):
                pass
    except ResultsError as error:
        if not all(folder.work.is_dir() for folder in opened):
            print("the sweep has ended", file=sys.stderr)
            return 0
        raise error
    finally:
        for share in shares:
            share.leases.close()
    return FAILURE if any(share.failures for share in shares) else 0


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
        print(printable(f"error: {error}"), file=sys.stderr)
        return getattr(error, "exit_code", FAILURE)
