"""The results folder as a report reads it: settings, tables and arrays."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax import __version__
from bojax.config.claims import Claim, Explanation
from bojax.config.component import Component
from bojax.config.errors import say
from bojax.config.sweep_file import Report, published_report
from bojax.experiments.settings import Learning, Planning
from bojax.problems.settings import ProblemSettings
from bojax.report.budgets import held
from bojax.report.columns import Arrays, Columns, read_columns, read_snapshot, where
from bojax.report.manifest import (
    Latency,
    Manifest,
    PointEntry,
    Unread,
    claims_of,
    experiment_of,
    read,
    validated,
)
from bojax.report.text import distinct, printed
from bojax.results.outline import Outline
from bojax.results.store import (
    ARRAYS,
    MANIFEST,
    TUNING,
    WORK,
    ResultsError,
    array_file,
    read_json,
    read_manifest,
    require_unchanged,
)

LATENCY = "latency.json"
"""File of a results folder that `bojax bench latency` writes."""

_NOT_MEASURED = ("point", "run", "episode", "seed", "nans", "planned_return")


@dataclass(frozen=True)
class Point:
    """One point of the sweep: a setting that was run with every seed."""

    index: int  # its number, the column `point` of every table
    label: str  # identifier of its planner or learner
    variant: str  # its name in the sweep
    name: str  # its name in the report: the variant, with the swept numbers where variants repeat
    swept: Mapping[str, Any]  # value of every swept key, by dotted path
    config: Mapping[str, Any]  # the settings of the experiment as plain values
    # The same settings as an object. An experiment given by import path has no properties but its parameters;
    # `Unread` are settings that this version of bojax refuses.
    experiment: Component | Unread
    outline: Outline  # the world of its problem

    @property
    def problem(self) -> Component | None:
        """Its problem; None of an experiment without a problem."""
        return self.experiment.problem if isinstance(self.experiment, Planning) else None

    @property
    def env(self) -> Component | None:
        """Its environment; None of an experiment without an environment."""
        return self.experiment.env if isinstance(self.experiment, Learning) else None

    @property
    def is_learning(self) -> bool:
        """Whether a run is many episodes of a learner."""
        return isinstance(self.experiment, Learning)

    @property
    def has_success(self) -> bool:
        """Whether its runs can succeed."""
        return not isinstance(self.problem, ProblemSettings) or self.problem.has_success

    @property
    def ends_at_success(self) -> bool:
        """Whether a run is known to be over once it has succeeded, so that its steps say when that was."""
        if isinstance(self.problem, ProblemSettings):
            return self.problem.ends_at_success
        return self.problem is not None

    @property
    def time_limit(self) -> int | None:
        """The most steps of an episode of its problem; None if unknown."""
        return getattr(self.problem, "max_steps", None) if isinstance(self.problem, ProblemSettings) else None


@dataclass(frozen=True)
class Results:
    """A finished results folder."""

    folder: Path
    manifest: Manifest  # `manifest.json`, checked
    points: tuple[Point, ...]
    # What was read of the episodes of a point and a phase
    _known: dict[tuple[Any, ...], NDArray[Any]] = field(default_factory=dict, init=False, compare=False)

    @property
    def report(self) -> Report:
        """The sweep's settings of the report."""
        return self.manifest.report

    @cached_property
    def claims(self) -> tuple[Claim | Unread, ...]:
        """The claims of the sweep."""
        return claims_of(self.manifest)

    @cached_property
    def explanations(self) -> Sequence[Explanation]:
        """Why claims are not reproduced or inconclusive.

        A sweep that is part of bojax has the explanations of this version, which may be later than the
        results. Any other sweep, even one of the same name, has the explanations in its manifest.
        """
        published = published_report(self.manifest.name) if self.manifest.is_published else None
        return (published or self.report).explanations

    @property
    def reference(self) -> Point | None:
        """The point that `report.relative_to` names, if it is one."""
        name = self.report.relative_to
        return next((point for point in self.points if name in (point.name, point.variant)), None)

    def thesis(self, point: Point, column: str) -> Any:
        """What `report.thesis` says of a column, for a name, a variant or a label; None where nothing.

        A label stands for all its variants, unless one of them has its name.
        """
        values = self.report.thesis
        names = [point.name, point.variant]
        if all(other.variant != point.label for other in self.points):
            names.append(point.label)
        rows = (row for name in names if isinstance(row := values.get(name), Mapping))
        return next((value for row in rows if (value := row.get(column)) is not None), None)

    def thesis_ratio(self, point: Point, column: str) -> float | None:
        """The thesis's number divided by its number for the reference; None unless both are positive."""
        pair = [self.thesis(each, column) for each in (point, self.reference) if each is not None]
        is_positive = all(isinstance(value, int | float) and value > 0 for value in pair)
        return float(pair[0] / pair[1]) if len(pair) == 2 and is_positive else None

    def require_settings(self, point: Point) -> None:
        """Refuse a point whose settings this version cannot read."""
        if isinstance(point.experiment, Unread):
            raise ResultsError(
                f"{self.folder}: this version of bojax cannot read the settings of {point.name} "
                f"({point.experiment.reason}); allowed: results of this version"
            )

    @cached_property
    def runs(self) -> Columns:
        """`runs.parquet`."""
        return read_columns(self.folder / "runs.parquet")

    @cached_property
    def steps(self) -> Columns:
        """`steps.parquet`; empty where the experiment has no steps."""
        return self._optional("steps")

    @cached_property
    def episodes(self) -> Columns:
        """`episodes.parquet`; empty where the experiment has no episodes."""
        return self._optional("episodes")

    def _optional(self, name: str) -> Columns:
        path = self.folder / f"{name}.parquet"
        return read_columns(path) if path.exists() else Columns()

    @cached_property
    def latency(self) -> Latency:
        """The latency of single runs, measured for these settings; without seconds if it was not measured."""
        path = self.folder / LATENCY
        if not path.exists():
            return Latency()
        found = validated(Latency, read_json(path), str(path))
        if found.config_hash != self.manifest.config_hash:
            raise ResultsError(f"{path}: measured for other settings than those of this folder")
        return found

    def only(self, points: Sequence[Point]) -> "Results":
        """The results of some points; the tables of neighbours are views of the tables of all points."""
        part = replace(self, points=tuple(points))
        indices = np.sort([point.index for point in points])
        first = indices[np.diff(indices, prepend=-2) > 1]  # of each row of neighbours
        last = indices[np.diff(indices, append=np.iinfo(int).max) > 1]
        for name in ("runs", "steps", "episodes"):
            table: Columns = getattr(self, name)
            if table:  # tables are sorted by point
                bounds = np.searchsorted(table["point"], [first, last + 1]).T.tolist()
                table = table.rows([slice(*each) for each in bounds])
            part.__dict__[name] = table
        return part

    @property
    def return_column(self) -> str:
        """The column of `runs.parquet` that is the return of a run, or of its last training episode."""
        # Earlier versions had `return` in learning as well.
        return "last_return" if "last_return" in self.runs else "return"

    def by_step(self, point: Point, column: str) -> NDArray[np.float64]:
        """A column of `steps.parquet` by run and step, `[runs, num_steps + 1]`; 0 at step 0.

        A run that has ended keeps its last value, see `held`. Rows correspond to `runs_of`.
        """
        rows, runs = self.steps_of(point), self.runs_of(point)["run"]
        table = np.full((runs.size, self.num_steps + 1), np.nan)
        row = np.searchsorted(runs, rows["run"])
        table[row, 0], table[row, rows["step"]] = 0.0, rows[column]
        return held(table, np.bincount(row, minlength=runs.size), self.final_runs(point))

    def by_episode(
        self, point: Point, column: str, phase: str = "train", *, is_summed: bool = False
    ) -> NDArray[np.float64]:
        """A column of `episodes.parquet` by run and episode as `recorded`, or its sum up to each episode.

        A run that its success ended keeps its last value, see `held`.
        """
        values, ends = self.recorded(point, column, phase), self.episodes_of(point, phase)
        if is_summed:
            values = np.nan_to_num(values).cumsum(axis=1)
        return held(values, ends - 1, self.final_runs(point)) if values.size else values

    @cached_property
    def has_early_success(self) -> bool:
        """Whether a success ended some run of a learner before the last episode of the longest run."""
        ended = [self.episodes_of(point)[self.final_runs(point)] for point in self.run_points]
        return min(map(int, np.concatenate(ended)), default=self.num_episodes) < self.num_episodes

    def recorded(self, point: Point, column: str, phase: str = "train") -> NDArray[np.float64]:
        """A column of `episodes.parquet` by run and episode, `[runs, episodes]`, the first episode first.

        Of several tests after one episode, the mean. NaN where a run had no such episode. As many columns
        as the longest run of any point has; rows correspond to `runs_of`.
        """
        key = (point.index, column, phase)
        if key not in self._known:
            values, episodes = self.episodes[column], self.episodes["episode"]
            of_points = [episodes[self._episode_rows(each, phase)] for each in self.points]
            last = max((int(each.max(initial=0)) for each in of_points), default=0)
            rows, runs = self._episode_rows(point, phase), self.runs_of(point)["run"]
            cell = np.searchsorted(runs, self.episodes["run"][rows]) * last
            cell += episodes[rows] - 1
            values = values[rows].astype(np.float64)
            count = np.bincount(cell, minlength=runs.size * last)
            total = np.bincount(cell, values, minlength=runs.size * last)
            means = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
            self._known[key] = means.reshape(runs.size, last)
        return self._known[key]

    def episodes_of(self, point: Point, phase: str = "train") -> NDArray[np.int64]:
        """The last training episode of each run, or the last one with a test; 0 without any."""
        rows, runs = self._episode_rows(point, phase), self.runs_of(point)["run"]
        last = np.zeros(runs.size, np.int64)
        np.maximum.at(last, np.searchsorted(runs, self.episodes["run"][rows]), self.episodes["episode"][rows])
        return last

    def _episode_rows(self, point: Point, phase: str) -> NDArray[np.intp]:
        """The rows of `episodes.parquet`, which is sorted by point, of a phase of a point."""
        key = (point.index, phase)
        if key not in self._known:
            start, stop = np.searchsorted(self.episodes["point"], [point.index, point.index + 1])
            self._known[key] = start + np.flatnonzero(self.episodes["phase"][start:stop] == phase)
        return self._known[key]

    def final_runs(self, point: Point) -> NDArray[np.bool_]:
        """Which runs of a point are over for good, so that their last values hold at every later place.

        These are runs of a learner that a success ended, and planning episodes that ended before their time
        limit or at a success. Experiments that are not known count as episodes without a time limit.
        """
        runs = self.runs_of(point)
        never, ever = np.zeros(runs["run"].size, bool), np.ones(runs["run"].size, bool)
        if isinstance(point.experiment, Learning):
            stop = {"first-success": "success", "target": "reached"}.get(point.experiment.stop, "")
            return runs.get(stop, never).astype(bool)
        if (limit := point.time_limit) is None or not self.steps:
            return ever
        steps = np.bincount(np.searchsorted(runs["run"], self.steps_of(point)["run"]), minlength=ever.size)
        return (steps < limit) | (point.ends_at_success & runs.get("success", never).astype(bool))

    @cached_property
    def num_episodes(self) -> int:
        """The most training episodes of any run."""
        return int(self.episodes["episode"].max(initial=0)) if self.episodes else 0

    @cached_property
    def num_steps(self) -> int:
        """The longest episode of any run, in steps."""
        return int(self.steps["step"].max()) if self.steps and self.steps["step"].size else 0

    def runs_of(self, point: Point) -> Columns:
        """The runs of one point."""
        return where(self.runs, point=point.index)

    def steps_of(self, point: Point) -> Columns:
        """The steps of one point."""
        return where(self.steps, point=point.index)

    @cached_property
    def run_points(self) -> list[Point]:
        """The points that have runs."""
        return [point for point in self.points if self.runs_of(point)["run"].size]

    def measured(self, table: Columns) -> list[str]:
        """The columns of numbers and Booleans of a table that were measured: neither keys nor settings."""
        hidden = {*_NOT_MEASURED, *(key for point in self.points for key in point.swept)}
        return [name for name, values in table.items() if values.dtype.kind in "bfiu" and name not in hidden]

    def shared_runs(self, points: Sequence[Point]) -> NDArray[Any]:
        """Indices of the runs that all points have."""
        return reduce(np.intersect1d, [self.runs_of(point)["run"] for point in points])

    def paired(self, points: Sequence[Point], column: str) -> NDArray[Any]:
        """Values of a column of `runs.parquet` of the runs that all points have, `[runs, points]`."""
        shared, tables = self.shared_runs(points), [self.runs_of(point) for point in points]
        return np.stack([table[column][np.searchsorted(table["run"], shared)] for table in tables], axis=1)

    def arrays(self, point: Point, name: str) -> Iterable[tuple[int, Arrays]]:
        """Run index and arrays of every kept snapshot `name` of a point, by run index."""
        for run in sorted(self.runs_of(point)["run"].tolist()) if self._snapshots else ():
            file = array_file(point.index, run, name)
            if file in self._snapshots:
                path, digest = self.folder / ARRAYS / file, self.manifest.sha256.get(f"{ARRAYS}/{file}")
                if digest is not None:
                    require_unchanged(path, digest)
                yield run, read_snapshot(path, name)

    @cached_property
    def _snapshots(self) -> set[str]:
        folder = self.folder / ARRAYS
        return {path.name for path in folder.iterdir()} if folder.is_dir() else set()


def load(folder: Path) -> Results:
    """A results folder; its tables are read when they are asked for.

    A line on standard error says if another version of bojax wrote it.

    Raises:
        ResultsError: The folder is missing or holds no results, its manifest is damaged, its sweep has not
            finished, all its runs have failed, or a table has changed since it was merged. Changed snapshots
            raise it when they are read.
    """
    if not os.path.isdir(folder):  # unlike `Path.is_dir`, false for a name that no file can have
        what = "a file, not a results folder" if os.path.exists(folder) else "no such results folder"
        raise ResultsError(f"{folder}: {what}")
    if (folder / TUNING).exists():
        best = f"its best point is the config {folder}/best.yaml"
        raise ResultsError(f"{folder}: a search of bojax tune, whose rounds are results folders; {best}")
    if not (folder / MANIFEST).exists() and (newest := _newest_below(folder)):
        raise ResultsError(f"{folder}: not a results folder; the newest below it is {newest}")
    if (folder / WORK).is_dir() and not (folder / MANIFEST).exists():
        raise _unfinished(folder)
    manifest = read(read_manifest(folder), str(folder / MANIFEST))
    if manifest.status not in ("finished", "failed"):
        raise _unfinished(folder)
    if manifest.status == "failed" and not (folder / "runs.parquet").exists():
        raise ResultsError(f"{folder}: all runs failed: bojax status {folder} says why")
    writer = manifest.versions.get("bojax", __version__)  # earlier versions did not always record it
    if writer != __version__:
        say(f"note: {folder} was written by bojax {writer}; this is {__version__}")
    for path in sorted(folder.glob("*.parquet")):
        if path.name in manifest.sha256:
            require_unchanged(path, manifest.sha256[path.name])
    name = manifest.name or folder.name
    named = manifest.model_copy(update={"name": name, "title": manifest.title or name})
    return Results(folder, named, _points(manifest.points))


def _newest_below(folder: Path) -> Path | None:
    """The results folder that was written last, at most two levels below: `results/NAME/TIME`."""
    found = [*folder.glob(f"*/{MANIFEST}"), *folder.glob(f"*/*/{MANIFEST}")]
    return max(found, key=lambda path: path.stat().st_mtime).parent if found else None


def _unfinished(folder: Path) -> ResultsError:
    return ResultsError(f"{folder}: this sweep has not finished: run it again with --resume --out {folder}")


def _points(entries: Sequence[PointEntry]) -> tuple[Point, ...]:
    points = []
    for entry in entries:
        experiment, variant = experiment_of(entry), entry.variant or entry.label
        problem = experiment.problem if isinstance(experiment, Planning) else None
        known = problem.outline if isinstance(problem, ProblemSettings) else Outline()
        settings = entry.swept, entry.config, experiment, entry.outline or known
        points.append(Point(entry.index, entry.label, variant, variant, *settings))
    names = distinct_names(points)
    return tuple(replace(point, name=name) for point, name in zip(points, names, strict=True))


def distinct_names(points: Sequence[Point]) -> list[str]:
    """Variants, each with the swept values that differ among points of the same variant.

    They are texts that can be drawn, see `printed`, and all different.
    """
    names = []
    for point in points:
        twins = [other.swept for other in points if other.variant == point.variant]
        differing = [
            f"{key.rsplit('.', 1)[-1]} {short_value(points, key, value)}"
            for key, value in point.swept.items()
            if not isinstance(value, Mapping) and any(other.get(key) != value for other in twins)
        ]
        names.append(printed(", ".join([point.variant, *differing])))
    return distinct(names)


def short_value(points: Sequence[Point], key: str, value: Any) -> Any:
    """A swept value for a name or a tick: a vector of 2 or 3 numbers as one, another list by its number."""
    if not isinstance(value, list):
        return value
    if len(value) in (2, 3) and all(isinstance(each, int | float) for each in value):
        return f"({', '.join(f'{each:g}' for each in value)})"
    return f"no. {swept_values(points, key).index(value) + 1}"


def swept_keys(points: Sequence[Point]) -> list[str]:
    """The swept keys with several values, in the order of the sweep."""
    keys = dict.fromkeys(key for point in points for key in point.swept)
    return [key for key in keys if len(swept_values(points, key)) > 1]


def swept_values(points: Sequence[Point], key: str) -> list[Any]:
    """The values of a swept key, in the order of the sweep."""
    values = [point.swept[key] for point in points if key in point.swept]
    return [value for index, value in enumerate(values) if value not in values[:index]]  # lists have no hash
