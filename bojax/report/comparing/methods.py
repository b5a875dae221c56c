"""The methods of a comparison: points of results folders, labels of CSV files, logs of other libraries."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bojax.config.errors import allowed_names
from bojax.envs.settings import Brax, Gymnasium
from bojax.experiments.settings import Learning, Planning
from bojax.report import ranking
from bojax.report.budgets import Series, budget_of, interval_of_times
from bojax.report.comparing.curve_files import Rows
from bojax.report.comparing.logs.grouping import rows_of
from bojax.report.comparing.logs.opening import Source
from bojax.report.drawing.curves import Curve
from bojax.report.manifest import Unread
from bojax.report.ranking import ENDS, signed
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats, Interval, mean_interval, share_interval
from bojax.report.text import counted, distinct, printed
from bojax.results.outline import Outline
from bojax.results.store import ResultsError

Kind: TypeAlias = Literal["planning", "learning"]
Axis: TypeAlias = Literal["episode", "step"]  # a training episode, or a step of the environment or plan
Phase: TypeAlias = Literal["train", "test"]

PHASES: tuple[Phase, ...] = ("train", "test")  # the phases of learning
PLANNING_CURVE = "accumulated_reward"  # the column of `steps.parquet` that is drawn as curves for planning


@dataclass(frozen=True)
class Options:
    """The options of the command; None for their defaults."""

    metric: str | None = None  # column, with a minus sign if less is better
    axis: Axis | None = None  # horizontal axis of curves
    phase: Phase = "train"  # of the episodes
    # Number of the last values of a run whose mean is its score; None for those in its last tenth, and the
    # last one in planning
    last: int | None = None
    at: int | None = None  # budget at which scores are taken; None for the largest that all methods have
    reference: str | None = None  # method that others are compared with; None for the first
    column: str | None = None  # of the logs of other libraries; None for the one that corresponds


@dataclass(frozen=True)
class Measure(ranking.Measure):
    """A compared column: of `episodes.parquet` or `runs.parquet`, or `accumulated_reward` of planning."""

    kind: Kind  # of the experiments
    axis: Axis
    options: Options = Options()

    @property
    def end(self) -> str:
        """The column of `runs.parquet` that has the end of a run on the axis of budgets."""
        return ENDS.get(self.column, "steps" if self.axis == "step" else "episodes")

    @property
    def unit(self) -> str:
        """What a budget counts: `step` or `episode`."""
        return self.end.removesuffix("s")


@dataclass(frozen=True, eq=False)
class Method:
    """A setting that is compared with others."""

    point: Point  # its name and colour
    source: Path  # its results folder, or file or folder of another library
    task: str  # the problem or environment; curves and scores of different tasks have different scales
    run: NDArray[np.integer]  # `[runs]` indices
    series: Sequence[Series]  # values of each run
    has_nan: NDArray[np.bool_]  # `[runs]` runs without a score
    has_curve: bool = True  # False of a column with one value per run
    seed: int | None = None  # None of other libraries, whose points have no settings
    is_time: bool = False  # whether scores are times to a goal or target
    is_rate: bool = False  # whether scores are 0 or 1, or means of such values
    log_column: str = ""  # column of a log of another library
    # Set by `scored`:
    scores: Floats = field(default_factory=lambda: np.zeros(0))  # `[runs]`
    at: float = 0.0  # the budget at which they are taken
    curve: Curve | None = None  # None where only scores are known

    @cached_property
    def budget(self) -> float:
        """The step or episode at which its longest run ended; infinite if every run is final."""
        return budget_of(self.series)

    @cached_property
    def cut_off(self) -> list[int]:
        """Indices of the runs that ended too early for the scores, and not by success."""
        return self._runs([each.is_cut_off(self.at) for each in self.series])

    @cached_property
    def without_value(self) -> list[int]:
        """Indices of the runs that logged no value up to the budget of the scores."""
        return self._runs([self.has_curve and not (each.x <= self.at).any() for each in self.series])

    @property
    def is_share(self) -> bool:
        """Whether every run either succeeds or fails, so that the mean score is a share of runs."""
        return self.is_rate and bool(np.isin(self.scores, (0, 1)).all())

    @property
    def mean(self) -> Interval:
        """Mean score with its interval, that of a rate between 0 and 1; NaN if a score is NaN."""
        if self.is_time:
            times, ends = np.array([(run.values[-1], min(run.end, self.at)) for run in self.series]).T
            return interval_of_times(times, ends, self.scores)(self.scores)
        if self.is_share:
            return share_interval(self.scores)
        mean = mean_interval(self.scores)
        return mean.within(0, 1) if self.is_rate else mean

    def _runs(self, chosen: Sequence[bool]) -> list[int]:
        return [int(run) for run, is_chosen in zip(self.run, chosen, strict=True) if is_chosen]

    @property
    def name(self) -> str:
        """Its name, unique within its task."""
        return self.point.name

    def is_paired_with(self, other: "Method") -> bool:
        """Whether runs of equal index had the same random numbers, and both have the same runs."""
        return self.seed is not None and self.seed == other.seed and np.array_equal(self.run, other.run)


def measured_by(results: Sequence[Results], options: Options, *, has_logs: bool = False) -> Measure:
    """What is compared; all folders have to be of one kind of experiment.

    With logs of other libraries, which count steps, the default axis is the step.
    """
    kinds: list[Kind] = [kind_of(each) for each in results]
    for each, kind in zip(results, kinds, strict=True):
        if kind != kinds[0]:
            raise ResultsError(
                f"{each.folder}: got results of {kind}, {results[0].folder} has results of {kinds[0]}; "
                "allowed: one of both"
            )
    kind: Kind = kinds[0] if kinds else "learning"
    if kind == "planning" and options.axis not in (None, "step"):
        raise ResultsError(f"--x: got {options.axis}; allowed of planning: step")
    axis: Axis = options.axis or ("step" if kind == "planning" or has_logs else "episode")
    metric = options.metric or (PLANNING_CURVE if kind == "planning" else "return")
    if options.phase == "test":
        for each in results:
            if not each.episodes or not (each.episodes["phase"] == "test").any():
                raise ResultsError(f"{each.folder}: has no test episodes; allowed: --phase train")
    return Measure(*signed(metric), kind, axis, options)


def methods_of(results: Sequence[Results], sources: Sequence[Source], measure: Measure) -> list[Method]:
    """The methods of all folders and of other libraries, whose tasks must occur in the folders."""
    found = [method for each in results for method in of_folder(each, measure)]
    known = list(dict.fromkeys(method.task for method in found))
    for path, rows in _by_path(sources, measure):
        _check_kind(path, rows, found, measure)
        for task in {each.task for each in rows}:
            if len(known) > 1 and not task:
                lacks = "has no task" if any(each.column for each in rows) else "no column task"
                raise ResultsError(f"{path}: {lacks}; allowed: a task among {', '.join(known)}")
            if known and task and task not in known:
                raise ResultsError(f"{path}: task: got {task}{allowed_names(task, known)}")
        found += of_file(path, rows, measure, known[0] if known else "")
    return named(found)


def _by_path(sources: Sequence[Source], measure: Measure) -> list[tuple[Path, list[Rows]]]:
    """The rows of each CSV file, then the rows of each label over all logs."""
    logs = [each for source in sources for each in source.logs]
    phase, column = measure.options.phase, measure.options.column
    if column is not None and not logs:
        raise ResultsError(f"--column: got {column}; allowed with logs of other libraries alone")
    of_logs = [(path, [rows]) for path, rows in rows_of(logs, measure.column, phase, measure.axis, column)]
    return [*((source.path, [*source.rows]) for source in sources if source.rows), *of_logs]


def _check_kind(path: Path, rows: Sequence[Rows], others: Sequence[Method], measure: Measure) -> None:
    """Refuse curves beside columns with one value per run, and scores beside curves."""
    if not others or rows[0].has_curve == others[0].has_curve:
        return
    if rows[0].has_curve:
        if others[0].seed is None:
            raise ResultsError(f"{path}: has curves, but {others[0].source} has scores; allowed: one of both")
        what = f"has curves, but {measure.column} has one value per run"
        raise ResultsError(f"{path}: {what}; allowed: results folders")
    raise ResultsError(
        f"{path}: has one score per run, but {others[0].name} has a curve; allowed: --metric COLUMN with a "
        "column of runs.parquet, such as last_return"
    )


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


def task_of(world: Any) -> str:
    """The name of the task of a world: its kind, or its own name if another library has it."""
    match world:
        case Gymnasium():
            return world.id
        case Brax():
            return world.name
        case _:
            return world.kind


def of_folder(results: Results, measure: Measure) -> list[Method]:
    """The points of a results folder that have runs, without scores."""
    known = columns_of(results)
    if measure.column not in known:
        raise ResultsError(
            f"{results.folder}: unknown metric {measure.column}{allowed_names(measure.column, known)}"
        )
    methods = []
    has_curve = measure.column in ([PLANNING_CURVE] if measure.kind == "planning" else results.episodes)
    table = results.episodes if has_curve else results.runs
    is_rate = measure.column in table and table[measure.column].dtype.kind == "b"
    for point in results.run_points:
        runs = results.runs_of(point)
        world = point.env or point.problem
        methods.append(
            Method(
                point,
                results.folder,
                "" if world is None else task_of(world),
                runs["run"],
                _series(results, point, measure) if has_curve else _single_values(results, point, measure),
                has_curve & (runs.get("nans", np.zeros(runs["run"].size)) > 0),
                has_curve,
                seed=results.manifest.seed,
                is_time=measure.column in ENDS,
                is_rate=is_rate,
            )
        )
    if not methods:
        raise ResultsError(f"{results.folder}: no run has been finished; allowed: at least one")
    return methods


def _series(results: Results, point: Point, measure: Measure) -> list[Series]:
    """The values of each run by step or episode."""
    finals = results.final_runs(point)
    if measure.kind == "planning":
        run, rows = results.runs_of(point)["run"], results.steps_of(point)["run"]
        table, sizes = results.by_step(point, measure.column), np.bincount(np.searchsorted(run, rows))
        return [
            Series(np.arange(size + 1.0), values[: size + 1], float(size), bool(is_final))
            for values, size, is_final in zip(table, sizes, finals, strict=True)
        ]
    values = results.recorded(point, measure.column, measure.options.phase)
    ends = np.broadcast_to(np.arange(1.0, values.shape[1] + 1), values.shape)
    if measure.axis == "step":
        ends = np.nancumsum(results.recorded(point, "length"), axis=1)[:, : values.shape[1]]
    last = results.episodes_of(point)
    series = []
    for x, each, end, is_final in zip(ends, values, last, finals, strict=True):
        there = np.isfinite(each)
        series.append(Series(x[there], each[there], float(x[end - 1]) if end else 0.0, bool(is_final)))
    return series


def _single_values(results: Results, point: Point, measure: Measure) -> list[Series]:
    """The value of a column of `runs.parquet` in each run, at the end of the run."""
    runs = results.runs_of(point)
    values = runs[measure.column].astype(np.float64)
    ends = runs.get(measure.end, np.zeros(values.size))
    finals = np.isfinite(values) if measure.column in ENDS else results.final_runs(point)
    return [
        Series(np.array([end]), np.array([value]), float(end), bool(is_final))
        for value, end, is_final in zip(values, ends, finals, strict=True)
    ]


def of_file(path: Path, rows: Sequence[Rows], measure: Measure, task: str) -> list[Method]:
    """The labels of another library, without scores; those without a task of their own have the given one.

    Raises:
        ResultsError: With episodes as the axis, runs of a label have different episodes.
    """
    methods = []
    for number, each in enumerate(rows):
        name = printed(each.label)
        point = Point(number, name, name, name, {}, {}, Unread({}, str(path)), Outline())
        if measure.axis == "episode" and each.has_curve:
            _check_equal_places(path, each)
        is_final = measure.kind == "planning" or not each.has_curve
        series = [Series(x, values, float(x[-1]), is_final) for x, values in each.runs.values()]
        run, has_nan = np.asarray(list(each.runs)), np.zeros(len(series), bool)
        own = point, path, each.task or task, run, series, has_nan, each.has_curve
        values = np.concatenate([one.values for one in series])
        is_rate = measure.column == "success" and 0 <= values.min() and values.max() <= 1
        methods.append(Method(*own, is_rate=bool(is_rate), log_column=each.column))
    return methods


def _check_equal_places(path: Path, rows: Rows) -> None:
    first, (x, _) = next(iter(rows.runs.items()))
    for run, (other, _) in rows.runs.items():
        if not np.array_equal(x, other):
            differing = sorted({*other.tolist()} ^ {*x.tolist()})[0]
            raise ResultsError(
                f"{path}: x: run {run} of {rows.label} has {counted(other.size, 'row')}, run {first} has "
                f"{x.size}, and only one of them has x = {differing:g}; allowed: equal x in all runs of a "
                "label (runs of any length: --x step)"
            )


def named(methods: Sequence[Method]) -> list[Method]:
    """The same methods with names that are unique within each task: by their sources, or by a number."""
    sources = list(dict.fromkeys(each.source for each in methods))
    short = {
        source: source.name
        if [other.name for other in sources].count(source.name) == 1
        else source.as_posix().strip("/")
        for source in sources
    }
    renamed = []
    for each in methods:
        twins = {other.source for other in methods if (other.task, other.name) == (each.task, each.name)}
        name = each.name if len(twins) == 1 else f"{each.name} ({printed(short[each.source])})"
        renamed.append(replace(each, point=replace(each.point, name=name)))
    for task in dict.fromkeys(each.task for each in renamed):
        places = [place for place, each in enumerate(renamed) if each.task == task]
        for place, name in zip(places, distinct(renamed[place].name for place in places), strict=True):
            renamed[place] = replace(renamed[place], point=replace(renamed[place].point, name=name))
    return renamed
