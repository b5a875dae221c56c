"""Errors of the final belief, and their ratios to those of one setting (Tables 3.1 and 4.1 of the thesis)."""

from typing import Any

from matplotlib.lines import Line2D

from bojax.report import style
from bojax.report.drawing.base import Drawing, FigureUnavailable, dot_plot, draw_intervals, drawn_points
from bojax.report.source import Results
from bojax.report.statistics import mean_interval, methods, ratio_interval
from bojax.report.text import number, ranged

RANK = 110

MEASURES = {
    "rmse": "RMSE: root mean square error",
    "wrmse": "WRMSE: RMSE with the weights of problem.weighting",
    "mnll": "MNLL: mean negative log likelihood",
}
"""Columns of `runs.parquet` that are drawn if the results have them."""

_THESIS: dict[str, Any] = {"marker": "D", "markersize": 5, "markerfacecolor": "white", "markeredgewidth": 1.2}


def draw(results: Results) -> Drawing:
    """A dot with its interval per point, one panel per measure; below, ratios to `report.relative_to`."""
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
