"""Errors of the final belief, and their ratios to one setting's beside the thesis's (Tables 3.1 and 4.1)."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from bojax.report import statistics, style
from bojax.report.drawing.base import Drawing, Undrawable, drawn_points
from bojax.report.source import Point, Results
from bojax.report.text import counted, number

RANK = 110

MEASURES = {
    "rmse": "RMSE: root mean square error",
    "wrmse": "WRMSE: the same, weighted towards what matters",
    "mnll": "MNLL: mean negative log likelihood",
}
"""Columns of `runs.parquet` that are drawn, where they are there."""


def draw(results: Results) -> Drawing:
    """A dot with its interval per point, one panel per measure; below, ratios to `report.relative_to`."""
    points, note = drawn_points(results)
    columns = [column for column in MEASURES if column in results.runs]
    if not columns:
        raise Undrawable(f"runs.parquet has none of {', '.join(MEASURES)}")
    ratios = [column for column in columns if any(results.thesis_ratio(point, column) for point in points)]
    rows = 2 if ratios else 1
    names = [style.wrapped(point.name, 16) for point in points]
    height = max(0.24, 0.06 + 0.17 * max(name.count("\n") + 1 for name in names))
    figure, grid = style.figure(rows * (0.75 + height * len(points)) + 0.15 * (rows > 1), rows, len(columns))
    figure.set_layout_engine("constrained", wspace=0.1)
    told = []
    for place, column in enumerate(columns):
        means = [statistics.mean_interval(results.runs_of(point)[column]) for point in points]
        _intervals(grid[0, place], points, means)
        grid[0, place].set_title(column.upper())
        told.append(", ".join(f"{p.name} {number(m.estimate)}" for p, m in zip(points, means, strict=True)))
    caption = (
        f"Final belief: mean error of {_runs(results, points)} with its 95% bootstrap interval; less "
        f"is better. {'. '.join(MEASURES[column] for column in columns)}.{note}"
    )
    reference = results.reference
    if ratios and reference is not None:
        for place, column in enumerate(columns):
            if column in ratios:
                _ratios(grid[1, place], results, points, reference, column)
                grid[1, place].set_title(f"{column.upper()} ratio")
            else:
                grid[1, place].set_visible(False)
        key: dict[str, Any] = {"linestyle": "", "color": style.INK}
        figure.legend(
            [Line2D([], [], marker="o", markersize=5, **key), Line2D([], [], **_THESIS, **key)],
            ["here", "thesis"],
            loc="outside lower center",
            ncols=2,
        )
        caption += (
            f" Below: ratios of the means to that of {reference.name}, ours paired by run. The thesis's "
            "are compared as ratios, since its field, and with it their unit, is known as a picture only."
        )
    for row in grid:
        for place, axes in enumerate(row):
            axes.set_yticks(*((range(len(points)), names) if place == 0 else ([], [])))
            for tick, look in zip(axes.get_yticklabels(), style.looks(points), strict=False):
                tick.set_color(look["color"])
    measures = "; ".join(f"{c.upper()}: {line}" for c, line in zip(columns, told, strict=True))
    return Drawing(
        figure=figure,
        title="Errors of the final belief",
        caption=caption,
        alt=f"Dot plots of the mean errors of the final belief with intervals. {measures}.",
    )


_THESIS: dict[str, Any] = {"marker": "D", "markersize": 5, "markerfacecolor": "white", "markeredgewidth": 1.2}


def _intervals(axes: Axes, points: tuple[Point, ...], intervals: list[statistics.Interval]) -> None:
    for row, (look, interval) in enumerate(zip(style.looks(points), intervals, strict=True)):
        axes.plot([interval.low, interval.high], [row, row], color=look["color"], linewidth=2)
        axes.scatter([interval.estimate], [row], s=24, color=look["color"], zorder=3)
    axes.set_ylim(len(points) - 0.5, -0.5)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=3))
    style.plain_ticks(axes.xaxis)
    axes.spines["left"].set_visible(False)
    style.quiet_grid(axes, "x")
    axes.tick_params(axis="y", length=0)


def _ratios(axes: Axes, results: Results, points: tuple[Point, ...], reference: Point, column: str) -> None:
    intervals = []
    for point in points:
        table = results.paired([point, reference], column)
        intervals.append(statistics.ratio_interval(table[:, 0], table[:, 1]))
    axes.axvline(1, color="#9A9A9A", linewidth=0.8, zorder=0.5)
    _intervals(axes, points, intervals)
    for row, point in enumerate(points):
        thesis = results.thesis_ratio(point, column)
        if thesis is not None and point is not reference:
            axes.plot([thesis], [row + 0.24], color=style.INK, zorder=4, **_THESIS)


def _runs(results: Results, points: tuple[Point, ...]) -> str:
    numbers = np.unique([results.runs_of(point)["run"].size for point in points])
    return counted(int(numbers[0]), "run") if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]} runs"
