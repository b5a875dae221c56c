"""Maps of the final belief about a field, and of its errors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LightSource, Normalize
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from bojax.report import style
from bojax.report.drawing.base import Drawing, name_panels, panel_grid
from bojax.report.drawing.domains import draw_outline, tick_outline
from bojax.report.drawing.maps import Belief, draw_map, draw_samples, draw_scale, errors_told, first_beliefs
from bojax.report.drawing.smooth import driven
from bojax.report.source import Results
from bojax.report.statistics import Floats
from bojax.report.text import joined, number

MAX_MAPS = 6  # most rows or maps that fit a screen; of more points, the best of each label is drawn

_PANELS = {"true field": "viridis", "mean": "viridis", "error": "RdBu_r", "std": "PuBu"}
"""Colour map of each column of the figure."""

_COLOURS = "YlGn_r"

_SHARED: dict[str, Any] = {"is_compressed": True, "sharex": True, "sharey": True}


def beliefs(results: Results) -> Drawing:
    """The final belief of one run per point beside the true field (Figs. 3.2 and 3.5 of the thesis)."""
    found, note = first_beliefs(results, MAX_MAPS)
    points, maps = [point for point, _, _ in found], [_maps(belief) for _, _, belief in found]
    norms = _norms(maps)
    figure, grid = style.figure(1.16 * len(points) + 0.75, len(points), len(_PANELS), **_SHARED)
    looks = style.looks(points)
    names = style.drawn_names(points)
    for row, name, (point, _, belief), look, values in zip(grid, names, found, looks, maps, strict=True):
        for axes, (panel, colours) in zip(row, _PANELS.items(), strict=True):
            draw_outline(axes, replace(point.outline, goals=()))
            draw_map(axes, belief, values[panel], norms[panel], colours)
            axes.set_xticks([])
            axes.set_yticks([])
        draw_samples(row[-1], belief)
        size = 10.5 if len(name) <= 14 else 8.0
        row[0].set_ylabel(style.wrapped(name, 19), color=look["color"], labelpad=2, fontsize=size)
    for axes, panel in zip(grid[0], _PANELS, strict=True):
        axes.set_title(panel, pad=4)
    for columns in ([0, 1], [2], [3]):
        image = grid[0, columns[0]].images[0]
        bar = draw_scale(figure, image, grid[:, columns].flat, aspect=9 * len(columns))
        bar.ax.xaxis.set_major_locator(MaxNLocator(nbins=2 + len(columns)))
    runs = joined(sorted({run for _, run, _ in found}))
    return Drawing(
        figure=figure,
        title="Final belief",
        caption="The true field, and the mean, error (red: too high) and standard deviation of the final "
        f"belief of run {runs}, in the unit of the field. All rows share the "
        f"scales of the columns. Dots: samples.{note}",
        alt="Maps of the true field and of the mean, error and standard deviation of the final belief, one "
        f"row per setting. Root mean square error on the map: {errors_told(found)}.",
    )


def _maps(belief: Belief) -> dict[str, Floats]:
    truth, mean = belief["truth"], belief["mean"]
    return {"true field": truth, "mean": mean, "error": mean - truth, "std": belief["std"]}


def _norms(maps: Sequence[Mapping[str, Floats]]) -> dict[str, Normalize]:
    """One scale for field and mean, a symmetric one for the error, one from 0 for the standard deviation."""
    fields = np.stack([values[panel] for values in maps for panel in ("true field", "mean")])
    error = max(float(np.abs(values["error"]).max()) for values in maps)
    std = max(float(values["std"].max()) for values in maps)
    field = Normalize(float(fields.min()), float(fields.max()))
    return {"true field": field, "mean": field, "error": Normalize(-error, error), "std": Normalize(0.0, std)}


def surfaces(results: Results) -> Drawing:
    """The true surface, and the final mean of one run per point (Figs. 3.5 and 3.7 of the thesis)."""
    maps, note = first_beliefs(results, MAX_MAPS - 1, of_heights=True)
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


def error_map(results: Results) -> Drawing:
    """The centred error of the final mean of one run per point (Fig. 3.8 of the thesis)."""
    maps, note = first_beliefs(results, MAX_MAPS, of_heights=True)
    errors = [belief["mean"] - belief["truth"] for _, _, belief in maps]
    offsets = [float(error.mean()) for error in errors]
    errors = [error - offset for error, offset in zip(errors, offsets, strict=True)]
    most = max(float(np.abs(error).max()) for error in errors)
    figure, grid = panel_grid(len(maps), lambda columns: 4.68 / columns, 0.75, **_SHARED)
    norm = Normalize(-most, most)
    for axes, (point, _, belief), error in zip(grid.flat, maps, errors, strict=False):
        draw_outline(axes, point.outline)
        tick_outline(axes, point.outline)
        draw_map(axes, belief, error, norm, "RdBu_r")
        for x_min, y_min, x_max, y_max, _ in point.outline.blocks:
            edge = {"facecolor": "none", "edgecolor": style.INK, "linewidth": 0.9, "zorder": 2.5}
            axes.add_patch(Rectangle((x_min, y_min), x_max - x_min, y_max - y_min, **edge))
        draw_samples(axes, belief)
    name_panels(grid.flat, [point for point, _, _ in maps])
    bar = draw_scale(figure, grid[0, 0].images[0], grid.flat, aspect=36, shrink=0.8)
    bar.set_label("centred error (m)")
    numbers = [
        f"{point.name}: offset {number(100 * offset)} cm, standard deviation "
        f"{number(100 * float(error.std()))} cm"
        for (point, _, _), offset, error in zip(maps, offsets, errors, strict=True)
    ]
    runs = joined(sorted({run for _, run, _ in maps}))
    return Drawing(
        figure=figure,
        title="Centred error of the map",
        caption=f"Difference between the mean of the final belief of run {runs} and the true heights, minus "
        f"its average, the offset (red: too high). {'; '.join(numbers)}. Outlines: props. "
        f"Dots: samples.{note}",
        alt=f"Maps of the centred error of the reconstructed heights. {'; '.join(numbers)}.",
    )
