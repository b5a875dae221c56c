"""Running sweeps: plan, execute, merge."""

import shlex
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bojax.config.errors import ConfigError, printable
from bojax.config.settings import Platform
from bojax.engine.conclude import conclude, interrupt
from bojax.engine.devices import Device, choose, find_devices, prepare
from bojax.engine.errors import FAILURE, EngineError
from bojax.engine.execute import execute
from bojax.engine.journal import Journal
from bojax.engine.latency import Latencies
from bojax.engine.remote import Launcher, run_remotely
from bojax.engine.requests import Request, Target, choose_targets, plan_unfinished
from bojax.engine.signals import StopRequest
from bojax.engine.tasks import longest_first, progress_of, tasks_of, workers_for
from bojax.results.store import ResultsError

if TYPE_CHECKING:
    from bojax.config.sweep import Sweep


def run_sweeps(
    requests: Sequence[Request],
    resume: bool,
    command: Sequence[str],
    finish: Callable[[Path], Any] = lambda _: None,
    *,
    exits: bool = True,
    launcher: Launcher | None = None,
    indices: Sequence[int] | None = None,
    planned: Callable[[], Any] = lambda: None,
) -> int:
    """Run or resume sweeps as one plan, and write their results folders.

    All sweeps are planned before the first one runs.

    Args:
        requests: The sweeps.
        resume: Continue unfinished sweeps, each in its `out` or in the newest unfinished folder of its name.
        command: The command line, for the manifests and for the hint on how to resume.
        finish: Called with the results folder of each finished sweep, for instance to write a report.
        exits: Whether a second signal ends the process at once.
        launcher: Starts workers that run the chunks; None to run them in this process.
        indices: Indices of the devices that this process uses; None for all.
        planned: Called before this process waits for devices or workers.

    Returns:
        The exit code: 0; 1 if something failed; 2 for an input error; 128 and its number after a signal.
    """
    try:
        with StopRequest(exits=exits) as stop:
            device = _common_device([request.sweep for request in requests])
            targets = choose_targets(requests, resume=resume)
            if launcher is not None:
                planned()
                return run_remotely(targets, command, finish, stop, launcher)
            prepare(device)
            devices = choose(find_devices(device), indices)
            return _run(targets, devices, command, finish, stop, planned)
    except (ConfigError, ResultsError, EngineError) as error:
        print(printable(f"error: {error}"), file=sys.stderr)
        return error.exit_code


def _run(
    targets: Sequence[Target],
    devices: Sequence[Device],
    command: Sequence[str],
    finish: Callable[[Path], Any],
    stop: StopRequest,
    planned: Callable[[], Any],
) -> int:
    start = time.monotonic()
    journals = [
        Journal(
            plan,
            target.path,
            shlex.join(command),
            is_resumed=target.is_resumed,
            may_rename=target.may_rename,
        )
        for target, plan in plan_unfinished(targets, devices, finish)
    ]
    for journal in journals:
        journal.note_seconds("planning", journals[0].planned - start)
    planned()
    return carry_out(journals, devices, command, finish, stop) if journals else 0


def _common_device(sweeps: Sequence["Sweep"]) -> Platform:
    """The device that all sweeps ask for."""
    asked = {sweep.engine.device: sweep.name for sweep in sweeps}
    if len(asked) > 1:
        each = ", ".join(f"{device} ({name})" for device, name in asked.items())
        raise ConfigError(f"engine.device: got {each}; allowed: one device for all sweeps")
    return sweeps[0].engine.device


def carry_out(
    journals: Sequence[Journal],
    devices: Sequence[Device],
    command: Sequence[str],
    finish: Callable[[Path], Any],
    stop: StopRequest,
) -> int:
    """Run planned sweeps, the only step that writes files, and return the exit code."""
    try:
        for journal in journals:
            journal.open()
        _execute(journals, devices, finish, stop)
        if stop:
            interrupt(journals, command)
            return stop.exit_code
        return FAILURE if any(journal.errors for journal in journals) else 0
    finally:
        for journal in journals:
            journal.close()


def _execute(
    journals: Sequence[Journal], devices: Sequence[Device], finish: Callable[[Path], Any], stop: StopRequest
) -> None:
    """Run the chunks of all sweeps; merge and finish each sweep once its chunks are done."""
    several = len(journals) > 1
    storages = {journal.launch(): journal for journal in journals}
    by_sweep = {
        journal: tasks_of(storage, journal.plan.chunks, stop.__bool__, name_sweep=several)
        for storage, journal in storages.items()
    }
    journal_of = {task: journal for journal, tasks in by_sweep.items() for task in tasks}
    tasks = longest_first(by_sweep.values())
    for task, journal in journal_of.items():
        journal.note_progress(task.group, task.progress)
    left = {journal: len(tasks) for journal, tasks in by_sweep.items()}
    workers = workers_for(tasks, devices)
    latencies = Latencies(devices, stop.__bool__)
    ended = [journal for journal in journals if not left[journal]]  # killed before it was merged
    for journal in ended:
        latencies.compile(journal)
    owned = {storage: journal.plan.chunks for storage, journal in storages.items()}
    with progress_of(owned, tasks) as progress:
        for task in execute(tasks, workers, progress, stop.__bool__):
            journal = journal_of[task]
            left[journal] -= 1
            if not left[journal]:
                ended.append(journal)
                latencies.compile(journal)
            if not left[journal] and several and not journal.plan.sweep.engine.latency:
                conclude(journal, progress.say, finish)  # while the other sweeps run
        latencies.measure(progress)
    for journal in ended if not stop else ():
        if not journal.is_merged:
            conclude(journal, lambda text: print(text, file=sys.stderr), finish)
