"""The final belief of one recorded run per point beside the true field: Figs. 3.2 and 3.5 of the thesis."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.ticker import MaxNLocator

from bojax.report import style
from bojax.report.drawing.base import Drawing
from bojax.report.drawing.domains import draw_outline
from bojax.report.drawing.maps import Belief, draw_map, draw_samples, draw_scale, errors_told, first_beliefs
from bojax.report.source import Results
from bojax.report.statistics import Floats
from bojax.report.text import joined

RANK = 130

MAX_ROWS = 6  # most rows that fit a screen; of more points, the best of each label is drawn

_PANELS = {"true field": "viridis", "mean": "viridis", "error": "RdBu_r", "std": "PuBu"}
"""Colour map of each column of the figure."""


def draw(results: Results) -> Drawing:
    """One row per point: true field, mean, error and standard deviation; field and mean share a scale."""
    found, note = first_beliefs(results, MAX_ROWS)
    points, maps = [point for point, _, _ in found], [_maps(belief) for _, _, belief in found]
    norms = _norms(maps)
    options: dict[str, Any] = {"is_compressed": True, "sharex": True, "sharey": True}
    figure, grid = style.figure(1.16 * len(points) + 0.75, len(points), len(_PANELS), **options)
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
