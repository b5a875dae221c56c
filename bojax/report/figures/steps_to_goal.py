"""Steps of the episodes that reach the goal, by episode: Fig. 5.7d of the thesis."""

import numpy as np

from bojax.report import statistics
from bojax.report.drawing.base import Drawing, Undrawable, drawn_points
from bojax.report.drawing.curves import add_curves, add_names, curve_figure
from bojax.report.source import Results
from bojax.report.text import number

RANK = 60


def draw(results: Results) -> Drawing:
    """Mean length of the successful training episodes; below, in how many runs an episode is successful."""
    if not {"length", "success"} <= results.episodes.keys():
        raise Undrawable("there is no episodes.parquet with length and success")
    points, note = drawn_points(results)
    lengths, shares = {}, {}
    for point in points:
        success, length = (results.by_episode(point, column) for column in ("success", "length"))
        lengths[point.index] = statistics.mean_band(np.where(success > 0, length, np.nan))
        is_there = np.isfinite(success)
        bounds = [
            statistics.wilson(int(hits), int(runs))
            for hits, runs in zip(np.nansum(success, axis=0), is_there.sum(axis=0), strict=True)
        ]
        low, high = np.array(bounds).T
        share = np.where(is_there.any(axis=0), np.nansum(success, axis=0), np.nan)
        shares[point.index] = (share / np.maximum(is_there.sum(axis=0), 1), low, high)
    if not any(np.isfinite(mean).any() for mean, _, _ in lengths.values()):
        raise Undrawable("no episode reached the goal")
    figure, grid = curve_figure(points, 2)
    add_curves(grid[0, 0], points, lengths, "steps to the goal", first=1)
    add_curves(grid[1, 0], points, shares, "episodes at the goal (%)", first=1, is_share=True)
    grid[1, 0].set_xlabel("episode")
    grid[0, 0].set_ylim(bottom=0)
    add_names(figure, grid[1, 0], points, shares)
    ends = ", ".join(f"{point.name} {number(_last(lengths[point.index][0]))}" for point in points)
    return Drawing(
        figure=figure,
        title="Steps to the goal",
        caption="Above: mean steps of the training episodes that reached the goal, with pointwise 95% "
        "bootstrap bands; the others are left out. Below: the share of runs whose episode reached it, with "
        f"Wilson bands.{note}",
        alt="Line charts over episodes of the mean steps to the goal, and of the share of runs that reach "
        f"it. Steps in the last episode: {ends}.",
    )


def _last(values: statistics.Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(known[-1]) if known.size else None
