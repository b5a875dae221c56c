"""The tables of the page: outcomes of the runs, ratios, speed and settings."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from bojax.config.changed import leaves
from bojax.experiments.settings import Trajectories
from bojax.report import statistics
from bojax.report.budgets import interval_of_times
from bojax.report.ranking import RankedPoint, measure_of, ranking
from bojax.report.source import Point, Results, swept_keys
from bojax.report.text import MISSING, counted, exact, heading, is_number, joined, number, plain, seconds
from bojax.results.store import ResultsError

FEW_POINTS = 12  # most points of a sweep that need no table of ranks
MAX_RANKED = 500  # most points in the table of ranks

BY_STEP = 6
"""Last step that counts as early success, unless `report.by_step` is given (thesis, p. 100)."""

LATENCY = "latency at batch 1"
"""Heading of the column of `speeds` that only results with a measured latency have."""

_IntervalOf: TypeAlias = Callable[[np.ndarray], statistics.Interval]


@dataclass(frozen=True)
class Cell:
    """A value, its interval and the thesis's value as text; interval and thesis's value may be empty.

    The key orders the rows of a table that its reader sorts; a cell whose key is empty comes last.
    """

    text: str
    interval: str = ""
    thesis: str = ""
    key: float | str = ""


@dataclass(frozen=True)
class Table:
    """Headings of the columns; for each row its heading and cells."""

    headings: list[str]
    rows: list[tuple[str, list[Cell]]]
    caption: str = ""

    @classmethod
    def ranked(cls, headings: list[str], rows: Iterable[list[Cell]], caption: str) -> "Table":
        """A table whose rows are headed by their ranks, from 1 on."""
        return cls(headings, [(str(rank), cells) for rank, cells in enumerate(rows, start=1)], caption)


@dataclass(frozen=True)
class _Measure:
    """A column of the table of outcomes, shown if `runs.parquet` has the columns that its cell needs."""

    heading: str
    name: str  # in `report.thesis`
    cell: Callable[..., Cell]
    columns: tuple[str, ...] = ()

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns that are passed to `cell`."""
        return self.columns or (self.name,)


def outcomes(results: Results) -> Table:
    """One row per point: means and shares of its runs with 95% intervals, beside the thesis's numbers."""
    measures, rows = _measures(results), []
    # A gallery of trajectories computes nothing that could be NaN.
    has_numbers = not all(isinstance(point.experiment, Trajectories) for point in results.points)
    for point in results.points:
        runs = results.runs_of(point)
        cells = [Cell(f"{runs['run'].size:,}")]
        for measure in measures:
            known = [runs[column] for column in measure.needs]
            cell = measure.cell(*known) if runs["run"].size else Cell(MISSING)
            value = results.thesis(point, measure.name)
            cells.append(replace(cell, thesis="" if value is None else plain(value)))
        if has_numbers:
            cells.append(Cell(f"{count_nan_runs(results, point):,}"))
        rows.append((point.name, cells))
    headings = ["runs", *(measure.heading for measure in measures), "runs with NaN"]
    return Table(headings if has_numbers else headings[:-1], rows)


def ranked(results: Results) -> Table | None:
    """The points in the order of the measure of `report.rank_by`; None for up to `FEW_POINTS` points."""
    if len(results.points) <= FEW_POINTS:
        return None
    try:
        measure = measure_of(results)
    except ResultsError:  # `ranking_gaps` says so
        return None
    ranked = ranking(results, measure, MAX_RANKED)
    if not ranked:
        return None
    keys = swept_keys([each.point for each in ranked])
    rows = []
    for each in ranked:
        swept = [setting_cell(each.point.swept.get(key)) for key in keys]
        rows.append([*score_cells(each, ranked[0]), *swept, count_cell(each.runs)])
    order = "least" if measure.is_least else "greatest"
    caption = (
        f"{counted(len(rows), 'point')} by {measure.words}, the {order} first, 95% intervals in brackets. "
        f"{BEHIND} The best point was chosen by these same runs, so its mean is optimistic; bojax best "
        "--confirm gives the mean of new runs."
    )
    if left_out := len(results.points) - len(rows):
        caption += f" {counted(left_out, 'point')} left out."
    return Table.ranked([measure.words, LAG, *keys, "runs"], rows, caption)


BEHIND = (
    "Behind the best: mean difference over equal runs. Where its interval contains 0, these runs do not tell "
    "the two apart."
)
"""What the second of `score_cells` means."""

LAG = "behind the best"  # its heading


def score_cells(point: RankedPoint, best: RankedPoint) -> list[Cell]:
    """The mean of a point, and how far it is behind the best."""
    lag = Cell(MISSING, key=0.0) if point is best else interval_cell(point.lag)
    return [interval_cell(point.mean), lag]


def ranking_gaps(results: Results) -> list[str]:
    """A note if `report.rank_by` names no column of numbers."""
    try:
        measure_of(results)
    except ResultsError as error:
        return [] if results.report.rank_by is None else [f"report.rank_by: {error}."]
    return []


def ratios(results: Results) -> Table | None:
    """Ratios of means to the means of `report.relative_to`, for columns with numbers in the thesis.

    None unless some column has at least two such numbers. A column with a number that is not positive is
    left out, since its ratios mean nothing.
    """
    reference = results.reference
    columns = [column for column in _thesis_columns(results) if _has_ratios(results, column)]
    if reference is None or not columns:
        return None
    rows = []
    for point in results.points:
        cells = []
        for column in columns:
            thesis = results.thesis_ratio(point, column)
            ratio = statistics.ratio_interval(*results.paired([point, reference], column).T)
            is_known = np.isfinite(ratio.low) and point is not reference
            text = ratio.in_words() if is_known else (number(ratio.estimate), "")
            cells.append(Cell(*text, "" if thesis is None else number(thesis)))
        if any(cell.thesis for cell in cells):
            rows.append((point.name, cells))
    return Table([f"{heading(column)} / {reference.name}" for column in columns], rows)


def thesis_gaps(results: Results) -> list[str]:
    """Notes on names in `report.thesis` and `report.relative_to` that the results do not have."""
    measured = {measure.name for measure in _measures(results)}
    unknown = [column for column in _thesis_columns(results) if column not in measured]
    notes = [f"report.thesis has {joined(unknown)}, which is no column of the results."] if unknown else []
    known = {name for point in results.points for name in (point.name, point.variant, point.label)}
    if strangers := [name for name in results.report.thesis if name not in known]:
        notes.append(f"report.thesis has numbers of {joined(strangers)}, but no setting is called that.")
    name = results.report.relative_to
    if name is not None and results.reference is None:
        notes.append(f"No ratios are shown, because no setting is called {name}.")
    return notes


def count_nan_runs(results: Results, point: Point) -> int:
    """Runs of a point with a NaN in any table; the column `nans` counts them."""
    return int((results.runs_of(point).get("nans", np.zeros(0)) > 0).sum())


def speeds(results: Results) -> Table | None:
    """One row per static group of the manifest; None where it has no timings.

    The latency of a group is measured for its points at batch 1; otherwise the column is missing.
    """
    points, known = {point.index: point for point in results.points}, results.latency.seconds
    unit = ["steps (plans) per second", "search iterations per second"]
    if any(point.is_learning for point in results.points):
        unit = ["environment steps per second"]
    rows = []
    for group in results.manifest.groups:
        members = [points[index] for index in group.points or [] if index in points]
        run, steps = group.run_seconds, group.active_steps
        rate = steps / run if steps and run else None
        planners = [getattr(point.experiment, "planner", None) for point in members]
        iterations = {_iterations(planner) for planner in planners}
        per_step = iterations.pop() if len(iterations) == 1 else None
        latencies = dict.fromkeys(seconds(known.get(str(point.index), (None,))[0]) for point in members)
        texts = [
            ", ".join(text for text in latencies if text != MISSING) or MISSING,
            MISSING if group.lanes_per_device is None else plain(group.lanes_per_device),
            MISSING if steps is None else f"{steps:,}",
            *[number(rate), number(rate * per_step if rate and per_step else None)][: len(unit)],
            seconds(run),
            seconds(group.compile_seconds),
        ]
        names = ", ".join(point.name for point in members)
        name = names if len(members) <= 3 else f"{len(members)} settings"
        rows.append((name, [Cell(text) for text in texts]))
    headings = [LATENCY, "lanes per device", "total steps", *unit, "run", "compile"]
    if all(cells[0].text == MISSING for _, cells in rows):  # not measured
        headings, rows = headings[1:], [(name, cells[1:]) for name, cells in rows]
    return Table(headings, rows) if rows else None


def _iterations(planner: Any) -> int | None:
    """The simulations of a plan, of all its trees together; None if the planner has none."""
    each = getattr(planner, "iterations", None)
    return None if each is None else each * getattr(planner, "trees", 1)


def settings(results: Results) -> tuple[list[tuple[str, str]], list[tuple[str, list[tuple[str, str]]]]]:
    """Settings that all points share, by dotted path, and per point those that they do not."""
    flat = [flatten(point.config) for point in results.points]
    common = [each for each in flat[0] if all(each in other for other in flat)]
    own = [[each for each in rows if each not in common] for rows in flat]
    return common, [(point.name, rows) for point, rows in zip(results.points, own, strict=True)]


def flatten(config: Mapping[str, Any]) -> list[tuple[str, str]]:
    """A nested mapping as dotted paths and values."""
    return [(path, exact(value)) for path, value in leaves(config)]


def _measures(results: Results) -> list[_Measure]:
    """Measures shown for every point: the known ones, then all other columns of numbers and Booleans."""
    runs, points = results.runs, results.points
    is_learning = any(point.is_learning for point in points)
    special = _LEARNING if is_learning else _planning(results.report.by_step or BY_STEP)
    known = {column for measure in special for column in measure.needs}
    if not is_learning and not all(point.ends_at_success for point in points):
        special = [measure for measure in special if "steps" not in measure.needs]
    if not is_learning and not all(point.has_success for point in points):
        special = [measure for measure in special if measure.name != "success"]
    others = [
        _Measure(heading(column), column, share_cell)
        if runs[column].dtype.kind == "b"
        else _Measure(heading(column), column, own_cell, (column, *(["nans"] if "nans" in runs else [])))
        for column in results.measured(runs)
        if column not in known
    ]
    return [measure for measure in special if runs.keys() >= {*measure.needs}] + others


def _planning(limit: int) -> list[_Measure]:
    def early(success: np.ndarray, steps: np.ndarray) -> Cell:
        return share_cell(success.astype(bool) & (steps <= limit))

    def when(success: np.ndarray, steps: np.ndarray) -> Cell:
        return mean_cell(steps[success.astype(bool)], empty="never", interval=statistics.time_interval)

    return [
        _Measure("final return", "return", mean_cell),
        _Measure("success", "success", share_cell),
        _Measure(f"success by step {limit}", f"success_by_{limit}", early, ("success", "steps")),
        _Measure("steps to success", "steps_to_success", when, ("success", "steps")),
        _Measure("runs with an exit", "exits", lambda exits: share_cell(exits > 0)),
    ]


def mean_cell(
    values: np.ndarray, *, empty: str = MISSING, interval: _IntervalOf = statistics.mean_interval
) -> Cell:
    """Mean with its interval; NaN if any value is NaN, which is never skipped."""
    if not values.size:
        return Cell(empty)
    bad = int((~np.isfinite(values.astype(np.float64))).sum())
    if bad:
        return Cell("NaN", f"in {counted(bad, 'run')}")
    return interval_cell(interval(values))


def own_cell(values: np.ndarray, nans: np.ndarray | None = None) -> Cell:
    """Mean of a column, or nothing if all values are null: the column belongs to a part of other points.

    A null is read as NaN. The column `nans` counts the NaN values of a run but not its nulls: if it counts
    none in one of the runs, the value there is null, and so are all.
    """
    is_null = nans is not None and not nans.all() and not np.isfinite(values).any()
    return Cell(MISSING) if is_null else mean_cell(values)


def among_cell(values: np.ndarray, interval: _IntervalOf = statistics.mean_interval) -> Cell:
    """Mean and standard deviation over the runs that have a value, and the number of these runs."""
    there = values[np.isfinite(values)]
    among = "" if there.size == values.size else f"{there.size:,} of {values.size:,}"
    if not there.size:
        return Cell("never", among)
    text, bounds = interval(there).in_words()
    if there.size == 1:
        return Cell(text, ", ".join(filter(None, [bounds, among])))
    spread = number(float(there.std(ddof=1)))
    return Cell(f"{text} ({spread})", f"{bounds}, {among}" if among else bounds)


def censored_cell(values: np.ndarray, ends: np.ndarray) -> Cell:
    """Lower bound of the mean over all runs: a run that never reached the goal counts with its end."""
    is_there = np.isfinite(values)
    counted = np.where(is_there, values, ends)
    text, bounds = interval_of_times(values, ends, counted)(counted).in_words()
    return Cell(text if is_there.all() else f"\N{GREATER-THAN OR EQUAL TO} {text}", bounds)


def share_cell(flags: np.ndarray) -> Cell:
    """Share with its Wilson interval."""
    return interval_cell(statistics.share_interval(flags), as_percent=True)


def interval_cell(interval: statistics.Interval, *, as_percent: bool = False) -> Cell:
    """An estimate with its interval, a share in per cent; nothing if the estimate is NaN."""
    if not np.isfinite(interval.estimate):
        return Cell(MISSING)
    return Cell(*interval.in_words(as_percent=as_percent), key=interval.estimate)


def count_cell(number: int) -> Cell:
    """A number of things."""
    return Cell(f"{number:,}", key=number)


def setting_cell(value: Any) -> Cell:
    """The value of a setting; nothing if a point does not have it."""
    if value is None:
        return Cell(MISSING)
    return Cell(plain(value), key=value if is_number(value) else plain(value))


def _times_among(values: np.ndarray, ends: np.ndarray) -> Cell:
    return among_cell(values, interval_of_times(values, ends, np.where(np.isfinite(values), values, ends)))


def _times(column: str, end: str) -> list[_Measure]:
    """When a goal was reached, NaN for never, in runs that ended at `end`."""
    words = heading(column)
    return [
        _Measure(f"{words}, runs that reached it", column, _times_among, (column, end)),
        _Measure(f"{words}, all runs", f"{column}_of_all", censored_cell, (column, end)),
    ]


_LEARNING = [
    _Measure("last training return", "last_return", mean_cell),
    _Measure("success", "success", share_cell),
    *_times("episodes_to_goal", "episodes"),
    *_times("steps_to_goal", "steps"),
    _Measure("target reached", "reached", share_cell),
    *_times("episodes_to_target", "episodes"),
    _Measure("return after target", "return_after_target", among_cell),
]


def _thesis_columns(results: Results) -> list[str]:
    rows = results.report.thesis.values()
    return list(dict.fromkeys(column for row in rows if isinstance(row, Mapping) for column in row))


def _has_ratios(results: Results, column: str) -> bool:
    values = [value for point in results.points if (value := results.thesis(point, column)) is not None]
    is_positive = all(isinstance(value, int | float) and value > 0 for value in values)
    known = [results.thesis_ratio(point, column) is not None for point in results.points]
    return column in results.runs and is_positive and sum(known) > 1
