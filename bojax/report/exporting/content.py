"""What is exported of each point: its settings, curves averaged over runs, and final numbers."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bojax.report.comparing import methods
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.report.tables import flatten
from bojax.report.text import plain


@dataclass(frozen=True, eq=False)
class MeanCurve:
    """A curve averaged over runs."""

    name: str  # phase and column, such as `train/return`; `accumulated_reward` of planning
    axis: str  # what `x` is: `episode` or `step`
    x: Floats  # `[n]` whole numbers in ascending order
    mean: Floats  # `[n]` mean over the runs that have a value there
    deviation: Floats  # `[n]` standard deviation over these runs, of n - 1; 0 for a single run

    def rows(self) -> list[tuple[int, float, float]]:
        """Its places as x, mean and standard deviation."""
        columns = (self.x.astype(np.int64), self.mean, self.deviation)
        return list(zip(*(column.tolist() for column in columns), strict=True))

    def named_rows(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Its places as x, and the values there by name; the standard deviation has the ending `_std`."""
        return ((x, {self.name: mean, f"{self.name}_std": deviation}) for x, mean, deviation in self.rows())


@dataclass(frozen=True)
class ExportedPoint:
    """A point of a sweep, which becomes one run of another library."""

    sweep: str  # name of the sweep
    name: str  # name of the point
    index: int
    settings: Mapping[str, str]  # by dotted path, as text; the number of runs and the seed among them
    # By column of `runs.parquet`, the mean over the runs with a value; with the ending `_std` the standard
    # deviation over them, and `_runs` their number where other runs have none
    scalars: Mapping[str, float]
    curves: list[MeanCurve]

    @property
    def finals(self) -> dict[str, float]:
        """Its scalars, with the prefix `final/` that distinguishes them from curves."""
        return {f"final/{name}": value for name, value in self.scalars.items()}


def exported(results: Results) -> list[ExportedPoint]:
    """The points that have runs."""
    kind = methods.kind_of(results)
    points = []
    for point in results.run_points:
        about = {"runs": str(results.runs_of(point)["run"].size), "seed": plain(results.manifest.seed)}
        settings = dict(flatten(point.config)) | about
        scalars, curves = _scalars(results, point), _curves(results, point, kind == "learning")
        points.append(
            ExportedPoint(results.manifest.name, point.name, point.index, settings, scalars, curves)
        )
    return points


def _scalars(results: Results, point: Point) -> dict[str, float]:
    runs, scalars = results.runs_of(point), {}
    for name in methods.columns_of(results):
        values = runs.get(name, np.empty(0)).astype(np.float64)
        there = values[np.isfinite(values)]
        if there.size:
            scalars[name] = float(there.mean())
            scalars[f"{name}_std"] = float(there.std(ddof=1)) if there.size > 1 else 0.0
        if 0 < there.size < values.size:
            scalars[f"{name}_runs"] = float(there.size)
    return scalars


def _curves(results: Results, point: Point, is_learning: bool) -> list[MeanCurve]:
    if not is_learning:
        name = methods.PLANNING_CURVE
        return [_mean_curve(name, "step", 0, results.by_step(point, name))] if name in results.steps else []
    columns = [name for name in methods.columns_of(results) if name in results.episodes]
    known = results.episodes["phase"] if results.episodes else ()
    phases = [phase for phase in methods.PHASES if phase in known]
    return [
        _mean_curve(f"{phase}/{name}", "episode", 1, results.by_episode(point, name, phase))
        for phase in phases
        for name in columns
    ]


def _mean_curve(name: str, axis: str, first: int, values: Floats) -> MeanCurve:
    """The mean over the runs with a value at each place, from a first one on."""
    is_there = np.isfinite(values)
    known = is_there.any(axis=0)
    table, count = np.where(is_there, values, 0.0)[:, known], is_there.sum(axis=0)[known]
    mean = table.sum(axis=0) / count
    squares = np.where(is_there[:, known], table - mean, 0.0) ** 2
    deviation = np.sqrt(squares.sum(axis=0) / np.maximum(count - 1, 1))
    return MeanCurve(name, axis, first + np.flatnonzero(known).astype(np.float64), mean, deviation)
