"""Chooses a run of a planner to animate, and reads its recorded data."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bojax.problems.settings import ProblemSettings
from bojax.report.animations.episode import pick, where
from bojax.report.columns import Columns
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.results.store import ResultsError


@dataclass(frozen=True)
class Leg:
    """One step of a planner: the plan and the path driven.

    Attributes:
        before: Pose before the step, `[3]`, in metres and radians.
        poses: Poses driven, `[S, 3]`.
        plan: Poses planned, `[S, 3]`, in the world frame; None if they were not recorded.
        frames: Generalised positions of the robot along the path, `[F, Q]`; None for a robot without a body.
        accumulated: Sum of the rewards up to the end of the step.
    """

    before: Floats
    poses: Floats
    plan: Floats | None
    frames: Floats | None
    accumulated: float


@dataclass(frozen=True)
class Drive:
    """A run of a planner.

    Attributes:
        point: The point of the sweep.
        run: Index of the run.
        legs: Its steps.
        belief: Maps of the belief about a field, as `FieldMonitoring.snapshot` records them; may be empty.
        outcome: How the run ended, in words; may be empty.
    """

    point: Point
    run: int
    legs: tuple[Leg, ...]
    belief: Mapping[str, Floats]
    outcome: str


def choose_drive(results: Results, point: int | None = None, run: int | None = None) -> Drive:
    """A recorded run of a planner, chosen by the arguments of `choose_film`.

    Raises:
        ResultsError: The run was not recorded.
    """
    kept = {part.index: dict(results.arrays(part, "paths")) for part in results.points}
    recorded = np.asarray([index for index, runs in kept.items() if runs], np.int64)
    if not recorded.size:
        raise ResultsError(f"{results.folder}: no paths were recorded (record.runs in the config: 1 or more)")
    index = pick(results, "point", point, recorded)
    chosen = next(part for part in results.points if part.index == index)
    run = pick(results, "run", run, np.asarray(list(kept[index]), np.int64))
    rows = where(results.steps_of(chosen), "run", run)
    order = np.argsort(rows["step"], kind="stable")
    legs = _legs(kept[index][run], {name: column[order] for name, column in rows.items()})
    if not legs:
        raise ResultsError(f"{results.folder}: run {run} made no step")
    return Drive(
        point=chosen,
        run=run,
        legs=legs,
        belief=dict(results.arrays(chosen, "belief")).get(run, {}),
        outcome=_outcome(chosen, where(results.runs_of(chosen), "run", run)),
    )


def _legs(arrays: Mapping[str, Floats], rows: Columns) -> tuple[Leg, ...]:
    paths, plans, frames = arrays["paths"], arrays.get("plans"), arrays.get("frames")
    pose = np.asarray(arrays["start"] if "start" in arrays else paths[0, 0], np.float64)
    legs = []
    for step in range(min(len(paths), len(rows["step"]))):
        poses = np.asarray(paths[step], np.float64)
        if not np.isfinite(poses).all():  # the simulation diverged
            break
        plan = None if plans is None else _placed(np.asarray(plans[step], np.float64), pose)
        shown = None if frames is None else np.asarray(frames[step], np.float64)
        legs.append(Leg(pose, poses, plan, shown, float(rows["accumulated_reward"][step])))
        # A robot that was stopped may have turned on the spot.
        pose = np.array([rows[name][step] for name in ("x", "y", "heading")]) if "x" in rows else poses[-1]
    return tuple(legs)


def _placed(path: Floats, pose: Floats) -> Floats:
    """A path in the robot's frame at a pose, transformed to the world frame."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    x = pose[0] + cos * path[:, 0] - sin * path[:, 1]
    y = pose[1] + sin * path[:, 0] + cos * path[:, 1]
    return np.stack([x, y, pose[2] + path[:, 2]], axis=-1)


def _outcome(point: Point, row: Columns) -> str:
    if row["success"][0]:
        return "goal reached"
    if row.get("nans", np.zeros(1))[0] > 0:
        return "failed"
    is_over = isinstance(point.problem, ProblemSettings) and point.problem.ends_at_exit
    return "left the domain" if is_over and row["exits"][0] > 0 else ""
