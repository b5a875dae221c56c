"""The trajectories of a motion family: Fig. 4.2 of the thesis, one panel per point of the sweep."""

from typing import Any

import numpy as np

from bojax.report import style
from bojax.report.drawing.base import Drawing, label_panels, panel_grid, points_with
from bojax.report.drawing.domains import ARROWS
from bojax.report.drawing.smooth import smooth
from bojax.report.source import Results
from bojax.report.text import counted


def trajectories(results: Results) -> Drawing:
    """All trajectories of the first run of each point, from a robot at the origin that heads right."""
    found, note = points_with(
        results,
        lambda point: {
            run: np.asarray(arrays["paths"], dtype=np.float64)
            for run, arrays in results.arrays(point, "trajectories")
            if run == 0 and "paths" in arrays
        },
        "no trajectories in arrays/",
    )
    points, paths = [point for point, _ in found], [kept[0] for _, kept in found]
    everything = np.concatenate([each[..., :2].reshape(-1, 2) for each in paths])
    low = np.minimum(np.nanmin(everything, axis=0), -0.05)
    high = np.maximum(np.nanmax(everything, axis=0), 0.05)
    margin = 0.08 * float((high - low).max())
    shape = float((high[1] - low[1] + 2 * margin) / (high[0] - low[0] + 2 * margin))

    def height(columns: int) -> float:
        return min((style.WIDTH - 0.6) / columns * shape, 4.0) + 0.3

    figure, grid = panel_grid(len(points), height, 0.4, sharex=True, sharey=True)
    arrow: dict[str, Any] = {"scale": 1 / 0.2, "width": 0.03, "headlength": 4.5, "headaxislength": 4}
    names = style.drawn_names(points)
    for axes, name, each, look in zip(grid.flat, names, paths, style.looks(points), strict=False):
        for path in each:
            curve = smooth(np.zeros(2), path)
            axes.plot(curve[:, 0], curve[:, 1], color=look["color"], linewidth=1.3)
        axes.quiver([0], [0], [1], [0], color=style.INK, zorder=5, **ARROWS, **arrow)
        axes.set_title(style.wrapped(name, 24), pad=4)
        axes.set_aspect("equal")
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
        axes.locator_params(nbins=5)
        style.quiet_grid(axes, "both")
    label_panels(grid, "x (m)", "y (m)")
    counts = [counted(len(each), "path") for each in paths]
    panels = "; ".join(f"{point.name}, {count}" for point, count in zip(points, counts, strict=True))
    return Drawing(
        figure=figure,
        title="Trajectories",
        caption=f"The robot is at the origin and heads right (arrow).{note}",
        alt=f"Trajectories from the origin, one panel per setting: {panels}.",
    )
