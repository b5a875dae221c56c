"""Surfaces of the true heights and of their reconstructions (Figs. 3.5 and 3.7 of the thesis)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LightSource, Normalize

from bojax.report.drawing.base import Drawing, name_panels, panel_grid
from bojax.report.drawing.maps import Belief, errors_told, first_beliefs
from bojax.report.drawing.smooth import driven
from bojax.report.source import Results
from bojax.report.statistics import Floats
from bojax.report.text import joined, number

RANK = 140

MAX_MAPS = 5  # most maps that fit a screen; of more points, the best of each label is drawn

_COLOURS = "YlGn_r"


def draw(results: Results) -> Drawing:
    """The true surface, and the final mean of one run per point with the path of the robot on it."""
    maps, note = first_beliefs(results, MAX_MAPS, of_heights=True)
    truth = maps[0][2]["truth"]
    maps = [entry for entry in maps if np.array_equal(entry[2]["truth"], truth)]
    heights = np.stack([truth, *(belief["mean"] for _, _, belief in maps)])
    low, high = float(heights.min()), float(heights.max())
    norm = Normalize(low, high)
    stretch = round(0.3 * max(np.ptp(maps[0][2][axis]) for axis in "xy") / max(high - low, 1e-9), 1)
    projection = {"projection": "3d", "computed_zorder": False}
    figure, grid = panel_grid(1 + len(maps), lambda columns: 1.95, 0.0, subplot_kw=projection)
    figure.set_layout_engine("none")  # no engine can measure the labels of a 3-D panel
    (rows, columns), panels = grid.shape, list(grid.flat)
    for index, axes in enumerate(panels):
        row, column = divmod(index, columns)
        axes.set_position((column / columns, 1 - (row + 0.92) / rows, 0.96 / columns, 0.82 / rows))
    _surface(panels[0], maps[0][2], truth, norm)
    panels[0].set_title("true surface", pad=-2)
    for axes, (point, run, belief) in zip(panels[1:], maps, strict=False):
        _surface(axes, belief, belief["mean"], norm)
        paths = dict(results.arrays(point, "paths")).get(run)
        if paths is not None:
            axes.plot(*_path(paths, belief).T, color="black", linewidth=1.0, zorder=3, clip_on=False)
    name_panels(panels[1:], [point for point, _, _ in maps], pad=-2)
    runs = joined(sorted({run for _, run, _ in maps}))
    return Drawing(
        figure=figure,
        title="Surface and reconstruction",
        caption=f"The true heights, and the mean of the final belief of run {runs}. Lengths are in metres; "
        f"heights, from {number(low)} to {number(high)} m, are drawn "
        f"{number(stretch)} times as large. Black: the path of the robot, projected onto "
        f"the surface.{note}",
        alt="Surfaces of the true heights and of their reconstructions with the trajectory in black. Root "
        f"mean square error: {errors_told(maps, ' m')}.",
    )


def _surface(axes: Any, belief: Belief, heights: Floats, norm: Normalize) -> None:
    x, y = np.meshgrid(belief["x"], belief["y"])
    shade = LightSource(azdeg=135, altdeg=50)
    colours = shade.shade(heights, cmap=colormaps[_COLOURS], norm=norm, vert_exag=2.0, blend_mode="soft")
    # Not clipped: the surface may extend beyond its panel, and there is room for it.
    exactly = {"rstride": 1, "cstride": 1, "linewidth": 0, "antialiased": False, "shade": False}
    axes.plot_surface(x, y, heights, facecolors=colours, rasterized=True, clip_on=False, **exactly)
    axes.set_box_aspect((np.ptp(x), np.ptp(y), 0.3 * max(np.ptp(x), np.ptp(y))), zoom=1.2)
    axes.set_zlim(norm.vmin, norm.vmax)
    axes.view_init(elev=42, azim=-60)
    axes.set_xticks([x.min(), x.max()])
    axes.set_yticks([y.min(), y.max()])
    axes.set_zticks([])
    axes.tick_params(pad=-5, labelsize=8.0)
    axes.grid(visible=False)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set_visible(False)
    axes.zaxis.line.set_visible(False)


def _path(paths: Mapping[str, Any], belief: Belief) -> Floats:
    """Points of the path, `[N, 3]`, at the height of the reconstruction."""
    from scipy.interpolate import RegularGridInterpolator  # only this figure needs its slow import

    _, _, points = driven(paths)
    axes = belief["x"], belief["y"]
    inside = np.clip(points, [axis[0] for axis in axes], [axis[-1] for axis in axes])
    return np.column_stack([points, RegularGridInterpolator(axes, belief["mean"].T)(inside)])
