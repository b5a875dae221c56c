"""Error of a map of heights, centred at zero (Fig. 3.8 of the thesis)."""

from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle

from bojax.report import style
from bojax.report.drawing.base import Drawing, name_panels, panel_grid
from bojax.report.drawing.domains import draw_outline, tick_outline
from bojax.report.drawing.maps import draw_map, draw_samples, draw_scale, first_beliefs
from bojax.report.source import Results
from bojax.report.text import joined, number

RANK = 150

MAX_MAPS = 6  # most maps that fit a screen; of more points, the best of each label is drawn


def draw(results: Results) -> Drawing:
    """The centred error of the final mean of one run per point, on a common scale, with outlined props."""
    maps, note = first_beliefs(results, MAX_MAPS, of_heights=True)
    errors = [belief["mean"] - belief["truth"] for _, _, belief in maps]
    offsets = [float(error.mean()) for error in errors]
    errors = [error - offset for error, offset in zip(errors, offsets, strict=True)]
    most = max(float(np.abs(error).max()) for error in errors)
    options: dict[str, Any] = {"is_compressed": True, "sharex": True, "sharey": True}
    figure, grid = panel_grid(len(maps), lambda columns: 4.68 / columns, 0.75, **options)
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
