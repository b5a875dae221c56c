"""The page of a search over settings, from the files of its folder."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bojax.optimisation.drawing import draw_progress, draw_slice
from bojax.optimisation.space import Axis, Choice
from bojax.report import style
from bojax.report.drawing.base import Drawing, label_panels, panel_grid
from bojax.report.manifest import Count, Recorded, read, validated
from bojax.report.page import provenance
from bojax.report.ranking import Measure, RankedPoint, ranking
from bojax.report.source import Results, load
from bojax.report.statistics import BAND, Interval
from bojax.report.tables import BEHIND, LAG, Cell, Table, count_cell, interval_cell, score_cells, setting_cell
from bojax.report.template import fill
from bojax.report.text import capitalised, counted, heading, joined, number, plain
from bojax.results.store import MANIFEST, TUNING, ResultsError, read_json, read_manifest, write_content
from bojax.tuning.ranges import described

MOST_RANKED = 50  # number of points in the table


Value = bool | float | str
"""The value of a tuned setting."""


class TriedPoint(Recorded):
    """A point of a search."""

    round: Count  # from 0
    values: list[Value]  # of each tuned setting
    score: float | None  # mean of the metric over its runs; None if a run has no finite value
    mean: float  # posterior mean of the metric
    std: float  # posterior standard deviation of the metric without noise


class Slice(Recorded):
    """The posterior over one setting, the others as at the best point."""

    values: list[Value]
    mean: list[float]
    std: list[float]


class SearchPlan(Recorded, strict=False):
    """What the proposals and the scores of a search depend on."""

    config: dict[str, Any]
    settings: dict[str, Axis]
    metric: str
    minimise: bool
    batch: Count
    runs: Count
    seed: Count


class Tuning(Recorded):
    """A finished search."""

    plan: SearchPlan
    name: str
    title: str
    points: list[TriedPoint]
    order: list[Count]
    noise_std: float
    slices: list[Slice]
    confirmed: str | None
    written: list[Value] | None = None  # values in the config as written, if it has all of the tuned settings

    @property
    def ranges(self) -> list[Axis]:
        """The tuned settings."""
        return list(self.plan.settings.values())

    @property
    def measure(self) -> Measure:
        """The measure that the search optimises."""
        return Measure(self.plan.metric, self.plan.minimise)

    @property
    def best(self) -> TriedPoint:
        """The point with the best posterior mean."""
        return self.points[self.order[0]]


def is_search(folder: Path) -> bool:
    """Whether a folder holds a finished search."""
    return os.path.isfile(folder / TUNING)


def read_tuning(folder: Path) -> Tuning:
    """The search in a folder."""
    path = folder / TUNING
    tuning = validated(Tuning, read_json(path), str(path))
    if not tuning.order or max(tuning.order) >= len(tuning.points):
        raise ResultsError(f"{path}: is damaged: delete it, and resume the search")
    return tuning


def round_name(number: int) -> str:
    """Name of the sweep of a round."""
    return f"round-{number:03d}"


def round_folder(search: Path, number: int) -> Path:
    """Results folder of a round, inside the folder of its search."""
    return search / "rounds" / f"{number:03d}"


def build_page(folder: Path) -> Path:
    """Write `report.html` of a finished search, and return its path."""
    tuning = read_tuning(folder)
    fresh = None if tuning.confirmed is None else load(folder / tuning.confirmed)
    with style.settings():
        plates = [draw(tuning).encoded() for draw in (_draw_slices, _draw_progress)]
    page = fill(
        "tuning.html.j2",
        title=f"{tuning.title}: tuned",
        summary=_summary(tuning, fresh),
        counts=[],
        plates=plates,
        confirmed=None if fresh is None else _confirmed(tuning, fresh),
        ranked=_ranked(tuning),
        settings=[
            (each.key, _range(each), plain(tuning.best.values[i])) for i, each in enumerate(tuning.ranges)
        ],
        folder=folder.name,
        provenance=_provenance(tuning, folder),
        footer="Written by bojax from the files of this folder, which hold every number shown here.",
    )
    path = folder / "report.html"
    write_content(path, page)
    return path


def _provenance(tuning: Tuning, folder: Path) -> list[tuple[str, str]]:
    """Provenance of the last round, with the time that all rounds and the fresh runs took."""
    *earlier, last = (round_folder(folder, number) for number in range(tuning.points[-1].round + 1))
    others = earlier if tuning.confirmed is None else [*earlier, folder / tuning.confirmed]
    results = load(last)
    manifests = [results.manifest, *(read(read_manifest(each), str(each / MANIFEST)) for each in others)]
    groups = [group for each in manifests for group in each.groups]
    return provenance(replace(results, manifest=results.manifest.model_copy(update={"groups": groups})))


def _summary(tuning: Tuning, fresh: Results | None) -> str:
    plan, best = tuning.plan, tuning.best
    runs = len(tuning.points) * plan.runs
    found = (
        f"{counted(len(tuning.points), 'point')} with {counted(plan.runs, 'run')} each, "
        f"{counted(runs, 'run')} in all. The best setting of the search is "
        f"{described(tuning.ranges, best.values)}: given these runs, the model expects a "
        f"{tuning.measure.words} of {number(best.mean)}"
    )
    if fresh is None:
        return f"{found}."
    ranked = ranking(fresh, tuning.measure)
    means = {each.point.index: each.mean for each in ranked}
    if 0 not in means:
        return f"{found}; some fresh runs have no finite value."
    mean, bounds = means[0].in_words()
    found = f"{found}, and {counted(fresh.manifest.runs or 0, 'fresh run')} have {mean} {bounds}."
    written = written_if_not_worse(ranked, tuning.measure, tuning.written)
    if written is None:
        return found
    return f"{found} The config as written is not worse on fresh runs: {' '.join(written.mean.in_words())}."


def written_if_not_worse(
    ranked: Sequence[RankedPoint], measure: Measure, written: Sequence[Any] | None
) -> RankedPoint | None:
    """The config as written among the fresh runs, if its mean is at least as good as the best setting's."""
    best = next((measure.sign * each.mean.estimate for each in ranked if each.point.index == 0), np.inf)
    for each in ranked:
        is_written = written is not None and [*each.point.swept.values()] == [*written]
        if is_written and each.point.index and measure.sign * each.mean.estimate >= best:
            return each
    return None


def _confirmed(tuning: Tuning, fresh: Results) -> Table:
    """The best points and the config as written, on fresh runs."""
    rows, alike = [], {}
    keys, columns = [each.key for each in tuning.ranges], fresh.measured(fresh.runs)
    ranked = ranking(fresh, tuning.measure)
    for each in ranked:
        values = [each.point.swept[key] for key in keys]
        expected = {tuple(tuning.points[i].values): place for place, i in enumerate(tuning.order, start=1)}
        place = expected.get(tuple(values))  # whole numbers are equal as integers and as floats
        name, written = f"{place} of {len(tuning.order)}", "as written in the config"
        name = written if not place else f"{name} ({written})" if values == tuning.written else name
        runs = fresh.runs_of(each.point)
        alike.setdefault(b"".join(runs[column].tobytes() for column in columns), []).append(name)
        cells = [Cell(name, key=place or ""), *score_cells(each, ranked[0])]
        rows.append([*cells, *map(setting_cell, values)])
    headings = ["in the search", tuning.measure.words, LAG, *keys]
    caption = (
        f"{counted(fresh.manifest.runs or 0, 'run')} of each setting with another seed, which the search has "
        f"not seen; 95% intervals in brackets. {BEHIND}"
    )
    for names in alike.values():
        if len(names) > 1:
            caption += f" Equal in every run: {joined(names)}; what they differ in has no effect there."
    return Table.ranked(headings, rows, caption)


def _ranked(tuning: Tuning) -> Table:
    """The points of the search by their posterior mean."""
    rows = []
    for index in tuning.order[:MOST_RANKED]:
        point = tuning.points[index]
        low, high = point.mean - BAND * point.std, point.mean + BAND * point.std
        expected = interval_cell(Interval(point.mean, low, high))
        score = Cell(number(point.score), key="" if point.score is None else point.score)
        values = map(setting_cell, point.values)
        rows.append([expected, score, *values, count_cell(point.round + 1)])
    headings = ["modelled score", "score", *(each.key for each in tuning.ranges), "round"]
    caption = (
        f"The best {counted(len(rows), 'point')} of {len(tuning.points)} by the posterior mean of the model, "
        f"its 95% interval in brackets. Score: {tuning.measure.words}, of {counted(tuning.plan.runs, 'run')} "
        "with the same random numbers for all points. The intervals, and the standard deviation of the noise "
        f"of a score that the model learned, {number(tuning.noise_std)}, are given these runs: they leave "
        "out the luck of the runs, and fresh runs decide. The best point was chosen by these runs, so its "
        "score is optimistic."
    )
    return Table.ranked(headings, rows, caption)


def _range(each: Axis) -> str:
    if isinstance(each, Choice):
        return f"one of {', '.join(map(plain, each.values))}"
    scale = ", on a logarithmic scale" if each.is_log else ""
    return f"{each.low:g} to {each.high:g}{scale}{', an integer' if each.is_integer else ''}"


def _draw_slices(tuning: Tuning) -> Drawing:
    """The posterior mean over each setting, the others as at the best point."""
    ranges, best = tuning.ranges, tuning.best
    figure, grid = panel_grid(len(ranges), lambda columns: 2.3, 0.4, sharey=True)
    tried = [point for point in tuning.points if point.score is not None]
    scores = [point.score for point in tried if point.score is not None]
    for index, (axes, each, curve) in enumerate(zip(grid.flat, ranges, tuning.slices, strict=False)):
        told = [point.values[index] for point in tried], scores
        draw_slice(axes, each, (curve.values, curve.mean, curve.std), told, (best.values[index], best.mean))
    label_panels(grid, None, f"mean {heading(tuning.plan.metric)}")
    return Drawing(
        figure,
        capitalised(f"{tuning.measure.words} over each setting"),
        "Line and band: posterior mean of a score without noise and its 95% interval, given the runs of the "
        "search, the other settings as at the best point (diamond). Dots: scores of all points, whose other "
        "settings differ.",
        f"The model expects a score of {number(best.mean)} at the best point.",
    )


def _draw_progress(tuning: Tuning) -> Drawing:
    """The score of every point, and the best score so far, by number of runs."""
    runs, spent = tuning.plan.runs, [tuning.plan.runs * (index + 1) for index in range(len(tuning.points))]
    figure, ((axes,),) = style.figure(2.8)
    best = draw_progress(axes, [point.score for point in tuning.points], tuning.measure.sign > 0, spent)
    axes.axhline(tuning.best.mean, color=style.ORANGE, linewidth=1.2, linestyle=(0, (5, 2)))
    axes.set_xlabel("runs")
    axes.set_ylabel(style.drawn_text(f"mean {heading(tuning.plan.metric)}"))
    return Drawing(
        figure,
        "Best score by number of runs",
        f"Dots: score of each point, a mean of {counted(runs, 'run')}. Line: best score so far, optimistic "
        "because of the noise. Dashed line: posterior mean of the best point.",
        f"The best score after {spent[-1]} runs is {number(float(best[-1]))}.",
    )
