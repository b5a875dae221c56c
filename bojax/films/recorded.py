"""Chooses a run of a planner, or an episode of a learner, to animate, and reads its recorded data."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax.problems.settings import ProblemSettings
from bojax.report.columns import Arrays, Columns, where
from bojax.report.drawing.sketches import Sketch, num_steps, taken
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.results.store import ResultsError


@dataclass(frozen=True)
class Episode:
    """The steps of one training episode."""

    point: Point
    run: int
    number: int  # number of the episode, from 1
    observations: Floats  # observation before each step, `[T, D]`
    actions: Floats  # actions taken, `[T, A]`
    frames: Floats  # further data for animations, `[T, Q]`; Q may be 0
    accumulated: Floats  # sum of the rewards up to and including each step, `[T]`
    outcome: str  # how the episode ended, in words; empty if it was not recorded


def choose_episode(
    results: Results, point: int | None = None, run: int | None = None, episode: int | None = None
) -> Episode:
    """A recorded episode, chosen by the arguments of `choose_film`."""
    steps = results.steps
    if not steps or not steps["step"].size:
        raise ResultsError(f"{results.folder}: no steps were recorded (record.runs in the config: 1 or more)")
    if "observation_0" not in steps:
        raise ResultsError(f"{results.folder}: steps have no observations, so nothing can be drawn")
    index = pick(results, "point", point, steps["point"])
    steps = where(steps, point=index)
    run = pick(results, "run", run, steps["run"])
    steps = where(steps, run=run)
    outcomes = _outcomes(results, index, run)
    if episode is None:
        recorded = np.unique(steps["episode"]).tolist()
        successes = [number for number in recorded if outcomes.get(number) == _SUCCESS]
        episode = [*successes, recorded[-1]][0]
    number = pick(results, "episode", episode, steps["episode"])
    steps = where(steps, episode=number)
    return Episode(
        point=next(each for each in results.points if each.index == index),
        run=run,
        number=number,
        observations=_vectors(steps, "observation"),
        actions=_vectors(steps, "action"),
        frames=_vectors(steps, "qpos"),
        accumulated=steps["accumulated_reward"].astype(np.float64),
        outcome=outcomes.get(number, ""),
    )


_SUCCESS = "goal reached"


def _outcomes(results: Results, point: int, run: int) -> dict[int, str]:
    """How every training episode of a run ended."""
    if not results.episodes:
        return {}
    episodes = where(results.episodes, point=point, run=run, phase="train")
    how = np.select([episodes["success"], episodes["terminated"]], [_SUCCESS, "failed"], "truncated")
    return dict(zip(episodes["episode"].tolist(), how.tolist(), strict=True))


@dataclass(frozen=True)
class Leg:
    """One step of a planner: the plan and the path driven."""

    before: Floats  # pose before the step, `[3]`, in metres and radians
    poses: Floats  # poses driven, `[S, 3]`
    plan: Floats | None  # poses planned, `[S, 3]`, in the world frame; None if they were not recorded
    # Generalised positions of the robot along the path, `[F, Q]`; None for a robot without a body
    frames: Floats | None
    accumulated: float  # sum of the rewards up to the end of the step


@dataclass(frozen=True)
class Drive:
    """A run of a planner."""

    point: Point
    run: int
    legs: tuple[Leg, ...]
    # Maps of the belief about a field, as `FieldProblem.snapshot` records them; may be empty
    belief: Mapping[str, Floats]
    outcome: str  # how the run ended, in words; may be empty


def choose_drive(results: Results, point: int | None = None, run: int | None = None) -> Drive:
    """A recorded run of a planner, chosen by the arguments of `choose_film`."""
    chosen, run, arrays = _recorded(results, "paths", point, run)
    legs = tuple(_legs(arrays, where(results.steps_of(chosen), run=run)))
    if not legs:
        raise ResultsError(f"{results.folder}: run {run} made no step")
    belief = dict(results.arrays(chosen, "belief")).get(run, {})
    return Drive(chosen, run, legs, belief, _outcome(chosen, where(results.runs_of(chosen), run=run)))


@dataclass(frozen=True)
class Trace:
    """A run of a planner on a state problem."""

    point: Point
    run: int
    sketch: Sketch
    accumulated: Floats  # sum of the rewards up to each step, 0 before the first, `[T + 1]`


def has_traces(results: Results) -> bool:
    """Whether runs on a state problem were recorded."""
    return any(True for point in results.points for _ in results.arrays(point, "sketch"))


def choose_trace(results: Results, point: int | None = None, run: int | None = None) -> Trace:
    """A recorded run on a state problem, chosen by the arguments of `choose_film`."""
    chosen, run, arrays = _recorded(results, "sketch", point, run)
    rows = where(results.steps_of(chosen), run=run)
    sketch = taken(arrays)
    accumulated = np.concatenate([[0.0], rows["accumulated_reward"]])[: num_steps(sketch) + 1]
    return Trace(chosen, run, sketch, accumulated)


def _recorded(results: Results, name: str, point: int | None, run: int | None) -> tuple[Point, int, Arrays]:
    """The chosen point and run, and the arrays that were recorded of it under a name."""
    kept = {each.index: dict(results.arrays(each, name)) for each in results.points}
    recorded = np.asarray([index for index, runs in kept.items() if runs], np.int64)
    if not recorded.size:
        what = "paths were" if name == "paths" else f"{name} was"
        raise ResultsError(f"{results.folder}: no {what} recorded (record.runs in the config: 1 or more)")
    index = pick(results, "point", point, recorded)
    chosen = next(each for each in results.points if each.index == index)
    run = pick(results, "run", run, np.asarray(list(kept[index]), np.int64))
    return chosen, run, kept[index][run]


def _legs(arrays: Mapping[str, Floats], rows: Columns) -> Iterator[Leg]:
    paths = arrays["paths"].astype(np.float64)
    plans, frames = arrays.get("plans"), arrays.get("frames")
    pose = np.asarray(arrays["start"] if "start" in arrays else paths[0, 0], np.float64)
    for step, (poses, accumulated) in enumerate(zip(paths, rows["accumulated_reward"], strict=False)):
        if not np.isfinite(poses).all():  # the simulation diverged
            break
        plan = None if plans is None else _placed(plans[step].astype(np.float64), pose)
        shown = None if frames is None else frames[step].astype(np.float64)
        yield Leg(pose, poses, plan, shown, float(accumulated))
        # A robot that was stopped may have turned on the spot.
        pose = np.array([rows[name][step] for name in ("x", "y", "heading")]) if "x" in rows else poses[-1]


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


def pick(results: Results, name: str, asked: int | None, values: NDArray[Any]) -> int:
    """The requested value, or by default the first recorded one."""
    recorded = np.unique(values).tolist()
    if asked is None:
        return recorded[0]
    if asked not in recorded:
        raise ResultsError(f"{results.folder}: no steps of {name} {asked}; recorded: {_ranges(recorded)}")
    return asked


def _ranges(numbers: Sequence[int]) -> str:
    """Sorted numbers as ranges: `0, 2 to 5`."""
    gaps = [i for i in range(1, len(numbers)) if numbers[i] != numbers[i - 1] + 1]
    ranges = [numbers[i:j] for i, j in zip([0, *gaps], [*gaps, len(numbers)], strict=True)]
    return ", ".join(f"{each[0]} to {each[-1]}" if len(each) > 1 else str(each[0]) for each in ranges)


def _vectors(steps: Columns, name: str) -> Floats:
    num = sum(key.startswith(f"{name}_") for key in steps)
    columns = [steps[f"{name}_{i}"] for i in range(num)]
    return np.array(columns, np.float64).reshape(num, len(steps["step"])).T
