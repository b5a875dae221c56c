"""Two swept numbers as a map: at each pair of values, the best mean over all other settings."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle

from bojax.config.errors import allowed_names
from bojax.report import style
from bojax.report.drawing.base import MAX_POINTS, Drawing, FigureUnavailable, label_panels, panel_grid
from bojax.report.drawing.maps import draw_scale
from bojax.report.ranking import Measure, measure_of
from bojax.report.source import Point, Results, swept_keys, swept_values
from bojax.report.statistics import Floats
from bojax.report.text import heading, is_number, minus, number, printed

RANK = 175

COLOURS = "cividis"  # a colour map that is read equally with all kinds of colour vision
MOST_NUMBERS = 60  # most cells of a map whose numbers are written
MOST_TICKS = 8  # most values that are written beside a panel

BOLD = {"facecolor": "none", "edgecolor": style.ORANGE, "linewidth": 2.2}


def draw(results: Results) -> Drawing:
    """One panel for each variant, on a common scale of colours; the best cell has a frame."""
    measure, points = measure_of(results), results.run_points
    horizontal, vertical = _keys(results, points)
    points = [point for point in points if {horizontal, vertical} <= point.swept.keys()]
    x, y = (sorted(swept_values(points, key)) for key in (horizontal, vertical))
    variants = list(dict.fromkeys(point.variant for point in points))[:MAX_POINTS]
    maps = [
        best_means(results, measure, [p for p in points if p.variant == name], (horizontal, x), (vertical, y))
        for name in variants
    ]
    known = np.concatenate([each[np.isfinite(each)] for each in maps])
    if not known.size:
        raise FigureUnavailable("no point has a finite mean")
    best = float(known.min() if measure.is_least else known.max())
    norm = Normalize(float(known.min()), float(known.max()) if np.ptp(known) else float(known.min()) + 1.0)
    # The colours of good values are light, whether more or less is better.
    cmap = COLOURS + ("_r" if measure.is_least else "")
    height = min(max(1.6, 0.34 * len(y) + 0.5), 4.0)
    figure, grid = panel_grid(len(maps), lambda columns: height, 1.3, sharex=True, sharey=True)
    for axes, values, name in zip(grid.flat, maps, variants, strict=False):
        image = axes.imshow(values, origin="lower", aspect="auto", norm=norm, cmap=cmap)
        for axis, ticked in ((axes.xaxis, x), (axes.yaxis, y)):
            shown = range(0, len(ticked), -(-len(ticked) // MOST_TICKS))
            axis.set_ticks(shown, [f"{ticked[place]:g}" for place in shown])
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        if len(maps) > 1:
            axes.set_title(style.wrapped(name, 26))
        if len(x) * len(y) <= MOST_NUMBERS and len(x) <= 8:
            _write_numbers(axes, image, values)
        for row, column in np.argwhere(values == best):
            axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, clip_on=False, **BOLD))
    label_panels(grid, heading(horizontal), heading(vertical))
    bar = draw_scale(figure, grid[0, 0].images[0], grid.flat, aspect=36, shrink=0.8)
    bar.set_label(style.drawn_text(measure.label))
    style.plain_ticks(bar.ax.xaxis)
    cells = {(point.variant, point.swept[horizontal], point.swept[vertical]) for point in points}
    over = ", the best over all other settings" if len(cells) < len(points) else ""
    name, values = next((name, values) for name, values in zip(variants, maps, strict=True) if best in values)
    row, column = np.argwhere(values == best)[0]
    place = f"{heading(horizontal)} {x[column]:g} and {heading(vertical)} {y[row]:g}"
    place += f" of {printed(name)}" if len(maps) > 1 else ""
    return Drawing(
        figure=figure,
        title=f"{heading(vertical)} and {heading(horizontal)}".capitalize(),
        caption=f"{measure.words.capitalize()} at each pair of values{over}. Frame: the best, {number(best)} "
        f"at {place}, chosen by these same runs. Empty: not run, or a run without a number.",
        alt=f"Map of the {measure.words} over {horizontal} and {vertical}; the best value is at {place}.",
    )


def best_means(
    results: Results,
    measure: Measure,
    points: Sequence[Point],
    horizontal: tuple[str, Sequence[Any]],
    vertical: tuple[str, Sequence[Any]],
) -> Floats:
    """The best mean of the points at each pair of values, `[vertical, horizontal]`; NaN without one."""
    (x_key, x), (y_key, y) = horizontal, vertical
    scores = np.full((len(y), len(x)), -np.inf)
    for point in points:
        mean = measure.sign * float(measure.values(results, point).mean())
        cell = y.index(point.swept[y_key]), x.index(point.swept[x_key])
        if np.isfinite(mean):
            scores[cell] = max(scores[cell], mean)
    return np.where(np.isfinite(scores), measure.sign * scores, np.nan)


def _keys(results: Results, points: Sequence[Point]) -> tuple[str, str]:
    """The two swept numbers: `report.heat_map`, or the first two."""
    numeric = [key for key in swept_keys(points) if all(map(is_number, swept_values(points, key)))]
    asked = results.report.heat_map or tuple(numeric[:2])
    unknown = [key for key in asked if key not in numeric]
    if unknown:
        raise FigureUnavailable(
            f"report.heat_map: {unknown[0]} is no swept number{allowed_names(unknown[0], numeric)}"
        )
    if len(set(asked)) < 2:
        raise FigureUnavailable("a map needs two swept numbers")
    return asked[0], asked[1]


def _write_numbers(axes: Axes, image: AxesImage, values: Floats) -> None:
    """Write the number of each cell in black or white, whichever is read better on its colour."""
    colours = image.to_rgba(values)
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            red, green, blue, _ = colours[row, column]
            ink = "#111111" if 0.299 * red + 0.587 * green + 0.114 * blue > 0.5 else "#fefefe"
            text = minus(number(float(value)))
            axes.text(column, row, text, ha="center", va="center", color=ink, fontsize=8)
