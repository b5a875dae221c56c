"""Effect of each swept setting: for each of its values, the best and the mean over all other settings."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bojax.report import style
from bojax.report.drawing.base import MAX_POINTS, Drawing, FigureUnavailable, label_panels, panel_grid
from bojax.report.ranking import measure_of
from bojax.report.source import Point, Results, short_value, swept_keys, swept_values
from bojax.report.text import distinct, is_number, number, printed, shortened

RANK = 170

MAX_PANELS = 8

MOST_LETTERS = 48  # letters that fit side by side below the panels


def draw(results: Results) -> Drawing:
    """One panel for each swept list of values, with two curves per label."""
    measure, points = measure_of(results), results.run_points
    names, keys = curves_and_panels(points)
    curves = list(dict.fromkeys(names))
    means = np.array([measure.values(results, point).mean() for point in points])
    if not np.isfinite(means).any():
        raise FigureUnavailable(f"no point has a finite {measure.words}")
    columns = max(
        1,
        min(
            3,
            len(curves),
            int(style.WIDTH / (0.5 + 0.08 * max(len(style.drawn_text(curve)) for curve in curves))),
        ),
    )
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
        style.legend(
            figure, [handles[curve] for curve in curves], names, loc="outside lower center", ncols=columns
        )
    winner = int(np.nanargmax(measure.sign * means))
    name = points[winner].name
    return Drawing(
        figure=figure,
        title="Effect of the settings",
        caption=f"{measure.words.capitalize()} for each value of a swept setting: the best over all other "
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
        return shortened(printed(str(value).lower()), 24)
    return f"{value / 1000:g}k" if abs(value) >= 1000 else f"{value:g}"
