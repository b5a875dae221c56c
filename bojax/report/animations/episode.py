"""Chooses an episode of a learning run to animate, and reads its recorded data."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax.report.animations.base import Moment
from bojax.report.columns import Columns
from bojax.report.source import Point, Results
from bojax.results.store import ResultsError


@dataclass(frozen=True)
class Episode:
    """The steps of one training episode.

    Attributes:
        point: The point of the sweep.
        run: Index of the run.
        number: Number of the episode, from 1.
        observations: Observation before each step, `[T, D]`.
        actions: Actions taken, `[T, A]`.
        frames: Further data for animations, `[T, Q]`; Q may be 0.
        accumulated: Sum of the rewards up to and including each step, `[T]`.
        outcome: How the episode ended, in words; empty if it was not recorded.
    """

    point: Point
    run: int
    number: int
    observations: NDArray[np.float64]
    actions: NDArray[np.float64]
    frames: NDArray[np.float64]
    accumulated: NDArray[np.float64]
    outcome: str

    def moment(self, step: int) -> Moment:
        """The recorded data of a step, counted from 0."""
        return Moment(self.observations[step], self.actions[step], self.frames[step])


def choose_episode(
    results: Results, point: int | None = None, run: int | None = None, episode: int | None = None
) -> Episode:
    """A recorded episode, chosen by the arguments of `choose_film`.

    Raises:
        ResultsError: The episode was not recorded.
    """
    steps = results.steps
    if not steps or not steps["step"].size:
        raise ResultsError(f"{results.folder}: no steps were recorded (record.runs in the config: 1 or more)")
    if "observation_0" not in steps:
        raise ResultsError(f"{results.folder}: steps have no observations, so nothing can be drawn")
    index = pick(results, "point", point, steps["point"])
    chosen = next(part for part in results.points if part.index == index)
    steps = where(steps, "point", index)
    run = pick(results, "run", run, steps["run"])
    steps = where(steps, "run", run)
    outcomes = _outcomes(results, index, run)
    if episode is None:
        recorded = sorted(set(steps["episode"].tolist()))
        successes = [number for number in recorded if outcomes.get(number) == _SUCCESS]
        episode = [*successes, recorded[-1]][0]
    number = pick(results, "episode", episode, steps["episode"])
    steps = where(steps, "episode", number)
    order = np.argsort(steps["step"], kind="stable")
    return Episode(
        point=chosen,
        run=run,
        number=number,
        observations=_vectors(steps, "observation")[order],
        actions=_vectors(steps, "action")[order],
        frames=_vectors(steps, "qpos")[order],
        accumulated=np.asarray(steps["accumulated_reward"], np.float64)[order],
        outcome=outcomes.get(number, ""),
    )


_SUCCESS = "goal reached"


def _outcomes(results: Results, point: int, run: int) -> dict[int, str]:
    """How every training episode of a run ended."""
    if not results.episodes:
        return {}
    episodes = where(where(results.episodes, "point", point), "run", run)
    episodes = where(episodes, "phase", "train")
    rows = zip(episodes["episode"], episodes["success"], episodes["terminated"], strict=True)
    return {
        int(number): _SUCCESS if success else "failed" if terminated else "truncated"
        for number, success, terminated in rows
    }


def pick(results: Results, name: str, asked: int | None, values: NDArray[Any]) -> int:
    """The requested value, or by default the first recorded one.

    Raises:
        ResultsError: The value was not recorded.
    """
    recorded = sorted(set(values.tolist()))
    if asked is None:
        return recorded[0]
    if asked not in recorded:
        raise ResultsError(f"{results.folder}: no steps of {name} {asked}; recorded: {_ranges(recorded)}")
    return asked


def _ranges(numbers: Sequence[int]) -> str:
    """Sorted numbers as ranges: `0, 2 to 5`."""
    gaps = [i for i in range(1, len(numbers)) if numbers[i] != numbers[i - 1] + 1]
    parts = [numbers[i:j] for i, j in zip([0, *gaps], [*gaps, len(numbers)], strict=True)]
    return ", ".join(f"{part[0]} to {part[-1]}" if len(part) > 1 else str(part[0]) for part in parts)


def where(columns: Columns, name: str, value: Any) -> Columns:
    """The rows with this value of a column."""
    kept = columns[name] == value
    return {key: column[kept] for key, column in columns.items()}


def _vectors(steps: Columns, name: str) -> NDArray[np.float64]:
    num = sum(key.startswith(f"{name}_") for key in steps)
    if num == 0:
        return np.zeros((len(steps["step"]), 0))
    return np.stack([np.asarray(steps[f"{name}_{i}"], np.float64) for i in range(num)], axis=-1)
