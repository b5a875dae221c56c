"""The trajectories of a motion family: Fig. 4.2 of the thesis, one panel per point of the sweep."""

import numpy as np

from bojax.report import style
from bojax.report.drawing.base import Drawing, Undrawable, drawn_points, panel_grid
from bojax.report.drawing.domains import ARROWS
from bojax.report.drawing.smooth import smooth
from bojax.report.source import Results
from bojax.report.text import counted

RANK = 160


def draw(results: Results) -> Drawing:
    """All trajectories of the first run of each point, from a robot at the origin that heads right."""
    points, note = drawn_points(results)
    found = {}
    for point in points:
        for run, arrays in results.arrays(point, "trajectories"):
            if run == 0 and "paths" in arrays:
                found[point.index] = np.asarray(arrays["paths"], dtype=np.float64)
    points = tuple(point for point in points if point.index in found)
    if not points:
        raise Undrawable("no trajectories in arrays/")
    everything = np.concatenate([paths[..., :2].reshape(-1, 2) for paths in found.values()])
    low = np.minimum(np.nanmin(everything, axis=0), -0.05)
    high = np.maximum(np.nanmax(everything, axis=0), 0.05)
    margin = 0.08 * float((high - low).max())
    rows, columns = panel_grid(len(points))
    shape = float((high[1] - low[1] + 2 * margin) / (high[0] - low[0] + 2 * margin))
    width = (style.WIDTH - 0.6) / columns
    figure, grid = style.figure(
        rows * (min(width * shape, 4.0) + 0.3) + 0.4, rows, columns, sharex=True, sharey=True
    )
    for axes, point, look in zip(grid.flat, points, style.looks(points), strict=False):
        for path in found[point.index]:
            curve = smooth(np.zeros(2), path)
            axes.plot(curve[:, 0], curve[:, 1], color=look["color"], linewidth=1.3)
        shape = {"scale": 1 / 0.2, "width": 0.03, "headlength": 4.5, "headaxislength": 4}
        axes.quiver([0], [0], [1], [0], color=style.INK, zorder=5, **ARROWS, **shape)
        axes.set_title(style.wrapped(point.name, 24), pad=4)
        axes.set_aspect("equal")
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
        axes.locator_params(nbins=5)
        style.quiet_grid(axes, "both")
    for axes in grid.flat[len(points) :]:
        axes.set_visible(False)
    for axes in grid[:, 0]:
        axes.set_ylabel("y (m)")
    for axes in grid[-1]:
        axes.set_xlabel("x (m)")
    panels = "; ".join(f"{point.name}, {counted(len(found[point.index]), 'path')}" for point in points)
    return Drawing(
        figure=figure,
        title="Trajectories",
        caption=f"The robot is at the origin and heads right (arrow).{note}",
        alt=f"Trajectories from the origin, one panel per setting: {panels}.",
    )
