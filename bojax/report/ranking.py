"""The points of a sweep in the order of a mean over their runs, and the config of the best one."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from bojax.config.errors import allowed_names
from bojax.report import statistics
from bojax.report.budgets import interval_of_times, times_within
from bojax.report.columns import NoColumn
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats, Interval
from bojax.report.text import counted
from bojax.results.store import ResultsError

ENDS = {"steps_to_goal": "steps", "episodes_to_goal": "episodes", "episodes_to_target": "episodes"}
"""For columns that are null in a run without success: the column of the end of a run. The end of the longest
run of all points then counts, so that no point gains by runs that ended early. Less of them is better."""


@dataclass(frozen=True)
class Measure:
    """A column of a table, and whether its least mean is the best."""

    column: str
    is_least: bool  # whether less is better

    @property
    def words(self) -> str:
        """The name of the measure in a sentence."""
        bound = ", or to the end of the longest run" if self.column in ENDS else ""
        return f"mean {self.column.replace('_', ' ')}{bound}"

    @property
    def label(self) -> str:
        """The name of the measure on an axis."""
        return f"mean {self.column.replace('_', ' ')}{', all runs' if self.column in ENDS else ''}"

    @property
    def sign(self) -> float:
        """The factor with which more is better."""
        return -1.0 if self.is_least else 1.0

    def values(self, results: Results, point: Point, longest: float | None = None) -> Floats:
        """Its value in each run of a point; NaN if missing.

        A time to a goal or target counts as `longest` if it is missing or longer. By default, that is the end
        of the longest run of the results.
        """
        values = results.runs_of(point)[self.column].astype(np.float64)
        longest = self.longest(results) if longest is None else longest
        return values if longest is None else times_within(values, longest)

    def longest(self, results: Results) -> float | None:
        """The end of the longest run; None if the measure is no time to a goal or target."""
        end = ENDS.get(self.column)
        return None if end is None else float(results.runs[end].max(initial=0))


@dataclass(frozen=True)
class RankedPoint:
    """A point in a ranking."""

    point: Point
    runs: int  # number of its runs
    mean: Interval  # mean of the measure, with its 95% interval
    # Mean difference from the best point over the runs of both, with its 95% interval; positive where this
    # point is worse
    lag: Interval


def signed(by: str) -> tuple[str, bool]:
    """A column that may follow a minus sign, and whether less is better: with the sign, and of all times."""
    column = by.removeprefix("-")
    return column, by != column or column in ENDS


def measure_of(results: Results, by: str | None = None) -> Measure:
    """The measure that ranks points: a column, with a minus sign if less is better, as `-rmse`, see `signed`.

    By default it is `report.rank_by`; without it `-steps_to_goal` if a learner reached a goal, and else
    `return`, or `last_return` of learners.
    """
    steps = results.runs.get("steps_to_goal", np.zeros(0)).astype(np.float64)
    usual = "-steps_to_goal" if np.isfinite(steps).any() else results.return_column
    by = next(name for name in (by, results.report.rank_by, usual) if name is not None)
    column, is_least = signed(by)
    known = results.measured(results.runs)
    if column not in known:
        raise NoColumn(f"runs.parquet: unknown column {column}{allowed_names(column, known)}")
    return Measure(column, is_least)


def ranking(results: Results, measure: Measure, most: int | None = None) -> list[RankedPoint]:
    """The points with runs, at most `most` and the best first; those with a non-finite value are left out."""
    runs = {point.index: results.runs_of(point) for point in results.points}
    values = {point.index: measure.values(results, point) for point in results.points}
    points = [point for point in results.run_points if np.isfinite(values[point.index]).all()]
    points.sort(key=lambda point: -measure.sign * float(values[point.index].mean()))  # ties stay in order
    ranked = []
    for point in points[:most]:
        own, best = (each.index for each in (point, points[0]))
        _, here, there = np.intersect1d(runs[own]["run"], runs[best]["run"], return_indices=True)
        both = np.stack([values[best][there], values[own][here]], axis=1)
        weights = measure.sign, -measure.sign
        if runs[own][measure.column].dtype.kind == "b":
            mean, lag = statistics.share_interval(values[own]), statistics.paired_shares(both, weights)
        else:
            mean_of, end = statistics.mean_interval, ENDS.get(measure.column)
            if end is not None:
                mean_of = interval_of_times(runs[own][measure.column], runs[own][end], values[own])
            mean, lag = mean_of(values[own]), statistics.mean_interval(both @ weights)
        ranked.append(RankedPoint(point, values[own].size, mean, lag))
    return ranked


def best_of(results: Results, measure: Measure) -> RankedPoint:
    """The best point."""
    ranked = ranking(results, measure, most=1)
    if not ranked:
        raise ResultsError(f"{results.folder}: {measure.column} is not finite in some run of every point")
    return ranked[0]


def scored(measure: Measure, point: RankedPoint) -> str:
    """The score of a point in one line."""
    mean, bounds = point.mean.in_words()
    told = bounds if bounds == statistics.NO_INTERVAL else f"95% interval {bounds}"
    return f"{measure.words}: {mean}, {told}, {counted(point.runs, 'run')}"


def config_of(results: Results, point: Point) -> dict[str, Any]:
    """The experiment of a point as the content of a config file. Its seed is the next one, for new runs."""
    results.require_settings(point)
    settings = dict(point.config)
    kind = settings.pop("kind")
    seed = ((results.manifest.seed or 0) + 1) % 2**32
    runs = int(results.runs_of(point)["run"].size)
    title = f"{results.manifest.title}: {point.name}"
    return {"title": title, "experiment": kind, **settings, "runs": runs, "seed": seed}
