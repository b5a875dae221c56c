"""The requested sweeps: their results folders, and which of them are unfinished."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bojax.config.errors import say
from bojax.config.points import Sweep
from bojax.engine.devices import Device, of_platform
from bojax.engine.plan import Plan, make_plan
from bojax.results.folder import (
    NothingToResume,
    RunFolder,
    check_finished,
    choose_folder,
    drop_leftovers,
    is_unfinished,
)


@dataclass(frozen=True)
class Request:
    """A sweep to run."""

    sweep: Sweep  # the sweep, with resolved import paths
    out: Path | None  # the results folder; None for `results/<name>/<timestamp>`


@dataclass(frozen=True)
class Target:
    """A sweep with its results folder."""

    sweep: Sweep
    path: Path  # the results folder
    is_resumed: bool  # whether the sweep has begun there
    may_rename: bool  # whether a new folder whose name is taken gets a number appended to the name


def choose_targets(requests: Sequence[Request], *, resume: bool) -> list[Target]:
    """The results folder of each sweep.

    Of several sweeps to resume, those without an unfinished folder are left out. In a new folder they begin:
    a command that was killed before it made its folder is repeated with `--resume` as well.

    Raises:
        NothingToResume: No sweep has an unfinished folder.
    """
    chosen, finished = [], []
    for request in requests:
        try:
            path, is_resumed = choose_folder(request.sweep.name, request.out, resume=resume)
            chosen.append(Target(request.sweep, path, is_resumed, request.out is None))
        except NothingToResume as error:
            finished.append(error)
    if not chosen:
        raise finished[0]
    for error in finished:
        say(f"note: {error}")
    if resume and not any(target.is_resumed for target in chosen):
        say_new([target.path for target in chosen])
    return chosen


def say_new(folders: Sequence[Path]) -> None:
    """Print a note that what was to be resumed begins in these folders."""
    others = f" and {len(folders) - 1} more" if len(folders) > 1 else ""
    say(f"note: nothing to resume; starting anew: {folders[0]}{others}")


def plan_unfinished(
    targets: Sequence[Target],
    devices: Sequence[Device],
    finish: Callable[[Path], Any],
    begins: Callable[[Plan], Any] = lambda _: None,
) -> list[tuple[Target, Plan]]:
    """Plan all sweeps, the longest first, and return those that are not finished yet, with their plans.

    `finish` is called with the folder of each sweep that is finished already, `begins` with each plan when it
    is made.

    Raises:
        ConfigError: A sweep cannot be built.
        ResultsError: A finished sweep is another one, or a saved learner cannot be read.
    """
    unfinished: dict[Path, Plan] = {}
    for target in sorted(
        targets, key=lambda target: 0 if target.is_resumed else -_rough_length(target.sweep)
    ):
        plan = make_plan(target.sweep, _devices_of(target, devices))
        if target.is_resumed and not is_unfinished(target.path):
            check_finished(target.path, plan.content)
            drop_leftovers(target.path)
            print(f"{target.path}: already finished")
            finish(target.path)
        else:
            unfinished[target.path] = plan
            if not target.is_resumed:
                begins(plan)
    return [(target, unfinished[target.path]) for target in targets if target.path in unfinished]


def _rough_length(sweep: Sweep) -> int:
    """Roughly the number of environment steps of a sweep, from its settings alone."""
    length = 0
    for point in sweep.points:
        steps = getattr(getattr(point.config, "env", None), "max_steps", None)
        length += sweep.runs * getattr(point.config, "episodes", 1) * (steps or 1)
    return length


def _devices_of(target: Target, devices: Sequence[Device]) -> Sequence[Device]:
    """The devices to plan a sweep for: if possible, of the platform that it began on."""
    if not target.is_resumed or not is_unfinished(target.path):
        return devices
    begun = RunFolder(target.path).plan()
    return devices if begun is None else of_platform(devices, begun["device"]["platform"]) or devices
