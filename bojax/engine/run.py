"""Running sweeps: plan, execute, merge."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bojax.config.errors import ConfigError, say
from bojax.config.points import Sweep
from bojax.config.settings import Platform
from bojax.engine.compile_processes import Ahead, CompileProcesses
from bojax.engine.devices import Device, choose, find_devices, prepare
from bojax.engine.execute import execute
from bojax.engine.remote import Launcher, run_remotely
from bojax.engine.signals import StopRequest
from bojax.engine.sweep_run import Invocation, SweepRun
from bojax.engine.targets import Request, Target, choose_targets, plan_unfinished
from bojax.engine.tasks import longest_first, progress_of, tasks_of, workers_for
from bojax.errors import UserError


def run_sweeps(
    requests: Sequence[Request],
    resume: bool,
    command: Sequence[str],
    finish: Callable[[Path], Any] = lambda _: None,
    *,
    launcher: Launcher | None = None,
    indices: Sequence[int] | None = None,
    planned: Callable[[], Any] = lambda: None,
) -> int:
    """Run or resume sweeps as one plan, and write their results folders.

    All sweeps are planned before the first one runs. Unfinished sweeps are resumed in their `out`, or in the
    newest unfinished folder of their name. The command line is for the manifests and for the hint on how to
    resume. A launcher starts workers that run the chunks; without one, this process runs them, on its devices
    of the given indices, by default on all. `finish` is called with the results folder of each finished
    sweep, for instance to write a report, and `planned` before this process waits for devices or workers.

    Returns:
        The exit code: 0; 1 if something failed; 2 for an input error; 128 and its number after a signal.
    """
    try:
        with StopRequest() as stop:
            device = _common_device([request.sweep for request in requests])
            targets = choose_targets(requests, resume=resume)
            invocation = Invocation(command, finish, stop)
            if launcher is not None:
                planned()
                return run_remotely(targets, invocation, launcher)
            prepare(device)
            devices = choose(find_devices(device), indices)
            with Ahead(devices) as ahead:
                return _run(targets, devices, invocation, planned, ahead)
    except UserError as error:
        say(f"error: {error}")
        return error.exit_code


def _run(
    targets: Sequence[Target],
    devices: Sequence[Device],
    invocation: Invocation,
    planned: Callable[[], Any],
    ahead: Ahead,
) -> int:
    """Plan the sweeps, run those that are not finished, and return the exit code."""
    start = time.monotonic()
    # A single sweep is executed as soon as it is planned.
    offer = ahead.offer if len(targets) > 1 else lambda _: None
    unfinished = plan_unfinished(targets, devices, invocation.finish, offer)
    runs = [SweepRun(plan, target, invocation.command) for target, plan in unfinished]
    for run in runs:
        run.note_seconds("planning", runs[0].planned - start)
    planned()
    try:
        for run in runs:
            run.open()
        if runs:
            _execute(runs, devices, invocation, ahead.processes)
        return invocation.exit_code(runs) if runs else 0
    finally:
        for run in runs:
            run.folder.close(finished=False)


def _common_device(sweeps: Sequence[Sweep]) -> Platform:
    """The device that all sweeps ask for."""
    asked = {sweep.engine.device: sweep.name for sweep in sweeps}
    if len(asked) > 1:
        each = ", ".join(f"{device} ({name})" for device, name in asked.items())
        raise ConfigError(f"engine.device: got {each}; allowed: one device for all sweeps")
    return sweeps[0].engine.device


def _execute(
    runs: Sequence[SweepRun], devices: Sequence[Device], invocation: Invocation, processes: CompileProcesses
) -> None:
    """Run the chunks of all sweeps; merge and finish each sweep once its chunks are done."""
    several = len(runs) > 1
    storages = {run.launch(): run for run in runs}
    by_sweep = {
        run: tasks_of(run.plan, storage.unfinished(run.plan.chunks), storage, name_sweep=several)
        for storage, run in storages.items()
    }
    run_of = {task: run for run, tasks in by_sweep.items() for task in tasks}
    tasks = longest_first(by_sweep.values())
    for task, run in run_of.items():
        run.progress[task.group.index] = task.progress
    left = {run: len(tasks) for run, tasks in by_sweep.items()}
    workers = workers_for(tasks, devices)
    owned = {storage: run.plan.chunks for storage, run in storages.items()}
    with progress_of(owned, tasks) as progress:
        for task in execute(tasks, workers, progress, invocation.stop.__bool__, processes):
            run = run_of[task]
            left[run] -= 1
            if not left[run] and several:
                run.finalise(progress.say, invocation.finish)  # while the other sweeps run
    for run in runs if not invocation.stop else ():
        if not left[run] and run.merged is None:  # also one that was killed before it was merged
            run.finalise(say, invocation.finish)
