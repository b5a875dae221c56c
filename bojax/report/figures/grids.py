"""Sweeps of several settings: the effect of each, and two swept numbers as a map."""

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
from bojax.report.source import Point, Results, short_value, swept_keys, swept_values
from bojax.report.statistics import Floats
from bojax.report.text import (
    capitalised,
    distinct,
    heading,
    is_number,
    minus,
    number,
    plain,
    printed,
    shortened,
)

MAX_PANELS = 8
MOST_LETTERS = 48  # letters that fit side by side below the panels
COLOURS = "cividis"  # a colour map that is read equally with all kinds of colour vision
MOST_NUMBERS = 60  # most cells of a map whose numbers are written
MOST_TICKS = 8  # most values that are written beside a panel

BOLD = {"facecolor": "none", "edgecolor": style.ORANGE, "linewidth": 2.2}


def settings(results: Results) -> Drawing:
    """For each value of a swept setting, the best and the mean over all other settings, by label."""
    measure, points = measure_of(results), results.run_points
    names, keys = curves_and_panels(points)
    curves = list(dict.fromkeys(names))
    means = np.array([measure.values(results, point).mean() for point in points])
    if not np.isfinite(means).any():
        raise FigureUnavailable(f"no point has a finite {measure.words}")
    longest = max(len(style.drawn_text(curve)) for curve in curves)
    columns = max(1, min(3, len(curves), int(style.WIDTH / (0.5 + 0.08 * longest))))
    spare = 0.6 + 0.2 * -(-len(curves) // columns)  # with the rows of the legend
    figure, grid = panel_grid(len(keys), lambda columns: 2.0, spare, sharey=True)
    labels, handles = [point.label for point in points], {}
    for axes, key in zip(grid.flat, keys, strict=False):
        values = swept_values(points, key)
        values = sorted(values) if all(map(is_number, values)) else values
        places = np.arange(len(values))
        for curve in curves:
            drawn = [index for index, name in enumerate(names) if name == curve]
            found = marginals([points[i] for i in drawn], measure.sign * means[drawn], key, values)
            best, mean = (measure.sign * each for each in found)
            first = points[drawn[0]]
            variants = [name for name in curves if points[names.index(name)].label == first.label]
            look = style.look(first.label, labels, variants.index(curve))
            dots = {"marker": look["marker"] or "o", "markersize": 3.5, "markevery": None}
            handles[curve] = axes.plot(places, best, **{**look, **dots})[0]
            axes.plot(places, mean, **{**look, "marker": ""}, alpha=0.35)
        ticks = [_short(short_value(points, key, value)) for value in values]
        axes.set_xticks(places, ticks, fontsize=8 if len(values) > 6 else 9.5)
        if max(map(len, ticks)) * len(ticks) > MOST_LETTERS / min(len(keys), 2):
            axes.tick_params(axis="x", labelrotation=35)
            for tick in axes.get_xticklabels():
                tick.set(ha="right", rotation_mode="anchor")
        axes.set_title(style.wrapped(key.removeprefix("planner."), 26))
        style.quiet_grid(axes)
    label_panels(grid, None, measure.label)
    if len(curves) > 1:
        names = distinct(map(style.drawn_text, curves))
        drawn = [handles[curve] for curve in curves]
        style.legend(figure, drawn, names, loc="outside lower center", ncols=columns)
    winner = int(np.nanargmax(measure.sign * means))
    name = points[winner].name
    return Drawing(
        figure=figure,
        title="Effect of the settings",
        caption=f"{capitalised(measure.words)} for each value of a swept setting: the best over all other "
        f"settings (dots) and the mean over them (faint). Best of {len(points)} settings, selected by these "
        f"same runs: {name}, {number(float(means[winner]))}.",
        alt=f"Line charts of the {measure.words} over {', '.join(keys)}; the best point is {name}.",
    )


def marginals(
    points: Sequence[Point], means: np.ndarray, key: str, values: Sequence[Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Best and mean of the means of points at each value of a key."""
    at = [means[[point.swept.get(key) == value for point in points]] for value in values]
    best, mean = (np.array([of(each) if each.size else np.nan for each in at]) for of in (np.max, np.mean))
    return best, mean


def curves_and_panels(points: Sequence[Point]) -> tuple[list[str], list[str]]:
    """Name of the curve of each point, and the keys of the panels.

    Axes with names are distinguished by curves. If these are too many, the last such axes get panels.
    """
    swept = swept_keys(points)
    named = [
        key for key in swept if all(point.swept.get(key) in point.variant.split("/") for point in points)
    ]
    if len(named) == len(swept):
        raise FigureUnavailable("the sweep has no list of values")
    while True:
        curves = ["/".join(str(point.swept[key]) for key in named) or point.label for point in points]
        if not named or len(set(curves)) <= MAX_POINTS:
            return curves, [key for key in swept if key not in named][:MAX_PANELS]
        named.pop()


def _short(value: Any) -> str:
    if not is_number(value):
        return shortened(printed(plain(value)), 24)
    return f"{value / 1000:g}k" if abs(value) >= 1000 else f"{value:g}"


def heat_map(results: Results) -> Drawing:
    """At each pair of values of two swept numbers, the best mean over all other settings, by variant."""
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
        title=capitalised(f"{heading(vertical)} and {heading(horizontal)}"),
        caption=f"{capitalised(measure.words)} at each pair of values{over}. Frame: the best, {number(best)} "
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
