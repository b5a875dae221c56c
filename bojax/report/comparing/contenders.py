"""The contenders of a comparison: points of results folders and labels of CSV files."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from bojax.config.errors import allowed_names
from bojax.experiments.settings import Learning, Planning
from bojax.report import ranking
from bojax.report.comparing.curve_files import Rows, read_curves
from bojax.report.drawing.curves import Curve
from bojax.report.manifest import Unread
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.report.text import counted
from bojax.results.outline import Outline
from bojax.results.store import ResultsError

Kind: TypeAlias = Literal["planning", "learning"]
Axis: TypeAlias = Literal["episode", "step"]  # a training episode, or a step of the environment or plan
Phase: TypeAlias = Literal["train", "test"]

PHASES: tuple[Phase, ...] = ("train", "test")  # the phases of learning
PLANNING_CURVE = "accumulated_reward"  # the column of `steps.parquet` that is drawn as curves for planning
GRID = 200  # number of places at which curves over the steps of an environment are compared

_LAST = 0.1


@dataclass(frozen=True)
class Measure(ranking.Measure):
    """A compared column: of `episodes.parquet` or `runs.parquet`, or `accumulated_reward` of planning."""

    kind: Kind  # of the experiments
    axis: Axis  # horizontal axis of curves
    phase: Phase = "train"  # of the episodes
    # Number of the last values of a run's curve whose mean is its score; None for those of the last tenth of
    # the axis, and the last one in planning
    last: int | None = None


@dataclass(frozen=True, eq=False)
class Contender:
    """A setting that is compared with others."""

    point: Point  # its name and colour
    source: Path  # its results folder or CSV file
    task: str  # the problem or environment; curves and scores of different tasks have different scales
    run: Floats  # `[runs]` indices
    scores: Floats  # `[runs]`
    curve: Curve | None  # None where only scores are known
    seed: int | None = None  # None of a CSV file, whose point has no settings
    is_share: bool = False  # whether scores are 0 or 1

    @property
    def name(self) -> str:
        """Its name, unique among those of its task."""
        return self.point.name

    def is_paired_with(self, other: "Contender") -> bool:
        """Whether runs of equal index had the same random numbers, and both have the same runs."""
        return self.seed is not None and self.seed == other.seed and np.array_equal(self.run, other.run)


@dataclass(frozen=True)
class Task:
    """The contenders on one problem or environment."""

    name: str  # empty if nothing says which
    contenders: Sequence[Contender]
    reference: Contender  # the one that others are compared with


def tasks_of(contenders: Sequence[Contender], reference: str | None) -> list[Task]:
    """Contenders by task; the reference is the one of this name, otherwise the first."""
    names = {each.name for each in contenders}
    if reference is not None and reference not in names:
        raise ResultsError(f"--reference: got {reference}{allowed_names(reference, names)}")
    tasks = []
    for name in dict.fromkeys(each.task for each in contenders):
        members = [each for each in contenders if each.task == name]
        chosen = next((each for each in members if each.name == reference), members[0])
        tasks.append(Task(name, members, chosen))
    return tasks


def measured_by(
    results: Sequence[Results], metric: str | None, axis: Axis | None, phase: Phase, last: int | None
) -> Measure:
    """What is compared, by the options of `compare`; all folders have to be of one kind of experiment."""
    kinds: list[Kind] = [kind_of(each) for each in results]
    for each, kind in zip(results, kinds, strict=True):
        if kind != kinds[0]:
            raise ResultsError(
                f"{each.folder}: got results of {kind}, {results[0].folder} has results of {kinds[0]}; "
                "allowed: one of both"
            )
    kind: Kind = kinds[0] if kinds else "learning"
    if kind == "planning" and axis not in (None, "step"):
        raise ResultsError(f"--x: got {axis}; allowed of planning: step")
    axis = axis or ("step" if kind == "planning" else "episode")
    metric = metric or (PLANNING_CURVE if kind == "planning" else "return")
    if phase == "test":
        for each in results:
            if not each.episodes or not (each.episodes["phase"] == "test").any():
                raise ResultsError(f"{each.folder}: has no test episodes; allowed: --phase train")
    return Measure(metric.removeprefix("-"), metric.startswith("-"), kind, axis, phase, last)


def contenders_of(results: Sequence[Results], files: Sequence[Path], measure: Measure) -> list[Contender]:
    """The contenders of all folders and CSV files, whose tasks have to be among those of the folders."""
    found = [contender for each in results for contender in of_folder(each, measure)]
    known = list(dict.fromkeys(contender.task for contender in found))
    for path in files:
        rows = read_curves(path)
        if found and results and found[0].curve is None:
            raise ResultsError(f"{path}: has curves, but {measure.column} has none; allowed: results folders")
        for task in {each.task for each in rows}:
            if len(known) > 1 and not task:
                raise ResultsError(f"{path}: no column task; allowed: a task among {', '.join(known)}")
            if known and task and task not in known:
                raise ResultsError(f"{path}: task: got {task}{allowed_names(task, known)}")
        found += of_file(path, rows, measure, known[0] if known else "")
    if len(found) < 2:
        raise ResultsError(f"got one curve, {found[0].name}; allowed: two or more")
    return named(found)


def kind_of(results: Results) -> Kind:
    """The kind of the experiments of a folder, whose settings this version has to be able to read."""
    for point in results.points:
        results.require_settings(point)
        if not isinstance(point.experiment, Learning | Planning):
            kind = point.config["kind"]
            raise ResultsError(f"{results.folder}: got the experiment {kind}; allowed: learning, planning")
    return "learning" if results.points[0].is_learning else "planning"


def columns_of(results: Results) -> list[str]:
    """The columns that can be compared, those with curves first."""
    found = [PLANNING_CURVE] if kind_of(results) == "planning" and PLANNING_CURVE in results.steps else []
    return list(dict.fromkeys([*found, *results.measured(results.episodes), *results.measured(results.runs)]))


def of_folder(results: Results, measure: Measure) -> list[Contender]:
    """The points of a results folder that have runs."""
    known = columns_of(results)
    if measure.column not in known:
        raise ResultsError(
            f"{results.folder}: unknown metric {measure.column}{allowed_names(measure.column, known)}"
        )
    contenders = []
    for point in results.run_points:
        runs = results.runs_of(point)
        curve = curve_of(results, point, measure)
        if curve is None:
            scores = measure.values(runs)
            is_share = runs[measure.column].dtype.kind == "b"
        else:
            has_nan = runs.get("nans", np.zeros(runs["run"].size)) > 0
            scores, is_share = np.where(has_nan, np.nan, _last(curve, measure)), False
        part, seed = point.env or point.problem, results.manifest.seed
        task = "" if part is None else part.kind
        contenders.append(Contender(point, results.folder, task, runs["run"], scores, curve, seed, is_share))
    if not contenders:
        raise ResultsError(f"{results.folder}: no run has been finished; allowed: at least one")
    return contenders


def of_file(path: Path, rows: Sequence[Rows], measure: Measure, task: str) -> list[Contender]:
    """The labels of a CSV file; those without a task of their own have the task that is given.

    Raises:
        ResultsError: With episodes as the axis, runs of a label have different episodes.
    """
    contenders = []
    for number, each in enumerate(rows):
        point = Point(number, each.label, each.label, each.label, {}, {}, Unread({}, str(path)), Outline())
        x, values = _common(path, each, measure)
        curve = Curve(point, x, values)
        run, scores = np.asarray(list(each.runs)), _last(curve, measure)
        contenders.append(Contender(point, path, each.task or task, run, scores, curve))
    return contenders


def named(contenders: Sequence[Contender]) -> list[Contender]:
    """The same contenders with names that are unique within each task: sources tell equal names apart."""
    sources = list(dict.fromkeys(each.source for each in contenders))
    short = {
        source: source.name
        if [other.name for other in sources].count(source.name) == 1
        else source.as_posix().strip("/")
        for source in sources
    }
    renamed = []
    for each in contenders:
        twins = [other for other in contenders if (other.task, other.name) == (each.task, each.name)]
        name = each.name if len(twins) == 1 else f"{each.name} ({short[each.source]})"
        point = replace(each.point, name=name)
        curve = each.curve and replace(each.curve, point=point)
        renamed.append(replace(each, point=point, curve=curve))
    return renamed


def curve_of(results: Results, point: Point, measure: Measure) -> Curve | None:
    """The curve of a column; None of a column that has one value per run."""
    column = measure.column
    if not point.is_learning:
        if column != PLANNING_CURVE:
            return None
        return Curve.numbered(point, results.by_step(point, column), first=0)
    if column not in results.episodes:
        return None
    values = results.by_episode(point, column, measure.phase)
    if measure.axis == "episode":
        return Curve.numbered(point, values, first=1)
    ends, known = np.nancumsum(results.by_episode(point, "length"), axis=1), np.isfinite(values)
    runs = [(x[there], each[there]) for x, each, there in zip(ends, values, known, strict=True)]
    return Curve(point, *_by_step(runs, ends_with_shortest=True))


def _common(path: Path, rows: Rows, measure: Measure) -> tuple[Floats, Floats]:
    """The places and the values `[runs, places]` of a label of a CSV file."""
    runs = list(rows.runs.values())
    if measure.axis == "step":
        return _by_step(runs, ends_with_shortest=measure.kind == "learning")
    first, (x, _) = next(iter(rows.runs.items()))
    for run, (other, _) in rows.runs.items():
        if not np.array_equal(x, other):
            differing = sorted({*other.tolist()} ^ {*x.tolist()})[0]
            raise ResultsError(
                f"{path}: x: run {run} of {rows.label} has {counted(other.size, 'row')}, run {first} has "
                f"{x.size}, and only one of them has x = {differing:g}; allowed: equal x in all runs of a "
                "label (runs of any length: --x step)"
            )
    return x, np.stack([values for _, values in runs])


def _by_step(runs: Sequence[tuple[Floats, Floats]], *, ends_with_shortest: bool) -> tuple[Floats, Floats]:
    """Values at common steps: each holds until the next one; NaN before the first.

    The steps end with the shortest run, since the longer runs alone would be another population. Otherwise a
    run that has ended keeps its last value.
    """
    ends = [x[-1] if x.size else 0.0 for x, _ in runs]
    last = min(ends) if ends_with_shortest else max(ends)
    spacing = max(1, int(np.ceil(last / GRID)))
    grid = np.arange(spacing if ends_with_shortest else 0, last + 1, spacing, dtype=np.float64)
    table = np.full((len(runs), max(1, grid.size)), np.nan)
    for row, (x, values) in enumerate(runs):
        place = np.searchsorted(x, grid, side="right") - 1
        table[row, : grid.size] = np.where(place >= 0, values[place] if values.size else np.nan, np.nan)
    return (grid if grid.size else np.ones(1)), table


def _last(curve: Curve, measure: Measure) -> Floats:
    """Mean of the last values of each run; NaN for a run without a value among them."""
    count = measure.last or (1 if measure.kind == "planning" else max(1, round(_LAST * curve.x.size)))
    tail = [values[np.isfinite(values)][-count:] for values in curve.values]
    return np.array([values.mean() if values.size else np.nan for values in tail])
