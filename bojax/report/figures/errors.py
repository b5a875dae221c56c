"""Errors of the final belief, and over the distance driven."""

from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from bojax.report import style
from bojax.report.drawing.base import Drawing, FigureUnavailable, dot_plot, draw_intervals, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Point, Results
from bojax.report.statistics import mean_interval, methods, ratio_interval
from bojax.report.text import number, ranged

MEASURES = {
    "rmse": "RMSE: root mean square error",
    "wrmse": "WRMSE: RMSE with the weights of problem.weighting",
    "mnll": "MNLL: mean negative log likelihood",
}
"""Columns of `runs.parquet` that are drawn if the results have them."""

_THESIS: dict[str, Any] = {"marker": "D", "markersize": 5, "markerfacecolor": "white", "markeredgewidth": 1.2}

MARKS = 40  # distances at which the curves have values

ERRORS = {"rmse": "RMSE", "mean_std": "mean standard deviation"}
"""Columns that are drawn, and their names."""


def errors(results: Results) -> Drawing:
    """Errors of the final belief above their ratios to `report.relative_to` (thesis, Tables 3.1 and 4.1)."""
    points, note = drawn_points(results)
    columns = [column for column in MEASURES if column in results.runs]
    if not columns:
        raise FigureUnavailable(f"runs.parquet has none of {', '.join(MEASURES)}")
    reference = results.reference
    ratios = [column for column in columns if any(results.thesis_ratio(point, column) for point in points)]
    # Labels of more ticks would touch each other in a third of the width.
    figure, grid = dot_plot(points, 2 if ratios else 1, len(columns), ticks=3 if len(columns) < 3 else 2)
    told = []
    for axes, column in zip(grid[0], columns, strict=True):
        means = [mean_interval(results.runs_of(point)[column]) for point in points]
        draw_intervals(axes, points, means)
        axes.set_title(column.upper())
        listed = [f"{point.name} {number(mean.estimate)}" for point, mean in zip(points, means, strict=True)]
        told.append(f"{column.upper()}: {', '.join(listed)}")
    counts = [results.runs_of(point)["run"].size for point in points]
    caption = (
        f"Mean error of the final belief of {ranged(counts, 'run')}, with its 95% interval "
        f"({methods(counts)}); smaller is better. {'. '.join(MEASURES[column] for column in columns)}.{note}"
    )
    if ratios and reference is not None:
        for axes, column in zip(grid[1], columns, strict=True):
            axes.set_visible(column in ratios)
            if column in ratios:
                axes.axvline(1, color="#9A9A9A", linewidth=0.8, zorder=0.5)
                pairs = [results.paired([point, reference], column).T for point in points]
                draw_intervals(axes, points, [ratio_interval(*pair) for pair in pairs])
                for row, point in enumerate(points):
                    thesis = results.thesis_ratio(point, column)
                    if thesis is not None and point is not reference:
                        axes.plot([thesis], [row + 0.24], color=style.INK, zorder=4, **_THESIS)
                axes.set_title(f"{column.upper()} ratio")
        key: dict[str, Any] = {"linestyle": "", "color": style.INK}
        handles = [Line2D([], [], marker="o", markersize=5, **key), Line2D([], [], **_THESIS, **key)]
        figure.legend(handles, ["here", "thesis"], loc="outside lower center", ncols=2)
        caption += (
            f" Below: ratios of the means to those of {reference.name}, paired by run. The numbers of "
            "the thesis are compared as ratios because it shows its field only as a picture, without a unit."
        )
    return Drawing(
        figure=figure,
        title="Errors of the final belief",
        caption=caption,
        alt=f"Dot plots of the mean errors of the final belief with intervals. {'; '.join(told)}.",
    )


def errors_by_distance(results: Results) -> Drawing:
    """Mean errors at equal distances driven; a run is constant between two steps, and ends with the last."""
    points, note = drawn_points(results)
    if not all("distance" in results.steps and column in results.steps for column in ERRORS):
        raise FigureUnavailable("steps.parquet has no errors by distance: problem.errors_by_step is false")
    longest = max(float(np.max(results.steps_of(point)["distance"], initial=0.0)) for point in points)
    marks = np.linspace(0.0, longest, MARKS + 1)[1:]
    panels = []
    for column, name in ERRORS.items():
        curves = [Curve(point, marks, _at(results, point, column, marks), (0, np.inf)) for point in points]
        panels.append(Panel(name, f"{name} averaged over runs", curves))
    details = "Errors of the belief after the last step before each distance; a run has none beyond its end."
    return Chart(panels, "distance (m)").drawing("Errors by distance", details, note)


def _at(results: Results, point: Point, column: str, marks: np.ndarray) -> np.ndarray:
    """A column at distances, `[runs, marks]`; NaN before the first step and beyond the last."""
    rows, runs = results.steps_of(point), results.runs_of(point)["run"]
    values = np.full((runs.size, marks.size), np.nan)
    for index, run in enumerate(runs):
        own = rows["run"] == run
        distance = rows["distance"][own]
        if distance.size:
            last = np.searchsorted(distance, marks * (1.0 + 1e-9), side="right") - 1
            known = (last >= 0) & (marks <= distance[-1] * (1.0 + 1e-9))
            values[index, known] = rows[column][own][last[known]]
    return values
