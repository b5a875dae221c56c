"""How a mean grows with a swept number: Figs. 5.6b and 5.6c of the thesis."""

from typing import Any

import numpy as np

from bojax.report import style
from bojax.report.drawing.base import Drawing, Undrawable
from bojax.report.drawing.swept import (
    add_legend,
    add_swept,
    caption_of,
    curve_looks,
    ends_of,
    heading,
    read_curves,
)
from bojax.report.source import Results

RANK = 80

_FITTED: dict[str, Any] = {"linewidth": 1.1, "linestyle": (0, (2, 2)), "zorder": 1.8}


def draw(results: Results) -> Drawing:
    """The same with the nearest law of growth; below on axes on which a power is a straight line."""
    over, column, curves = read_curves(results)
    laws = [curve.law for curve in curves]
    if not any(laws):
        raise Undrawable("a law of growth needs positive means at four values at least")
    figure, grid = style.figure(5.6, 2)
    for axes in grid[:, 0]:
        add_swept(axes, curves)
        for curve, law, look in zip(curves, laws, curve_looks(curves), strict=True):
            if law is not None:
                x = np.linspace(curve.x[0], curve.x[-1], 200)
                fitted = np.where(law(x) > 0, law(x), np.nan)
                axes.plot(x, fitted, **{**look, **_FITTED, "color": style.INK})
        axes.set_ylabel(f"mean {heading(column)}")
    grid[0, 0].set_ylim(bottom=0)
    lower = grid[1, 0]
    lower.set_xscale("log")
    lower.set_yscale("log")
    numbers = curves[0].x
    ticks = (
        numbers if len(numbers) <= 8 else numbers[np.unique(np.geomspace(1, len(numbers), 6).astype(int)) - 1]
    )
    lower.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    lower.minorticks_off()
    lower.yaxis.set_major_formatter(lambda value, _: f"{value:,.10g}")
    style.quiet_grid(lower, "both")
    lower.set_xlabel(f"{heading(over)} (above: even scale, below: logarithmic)")
    add_legend(figure, grid[0, 0], curves)
    told = [
        f"{curve.point.name} {law.law}, {law}"
        for curve, law in zip(curves, laws, strict=True)
        if law is not None
    ]
    return Drawing(
        figure=figure,
        title=f"Growth of {heading(column)}",
        caption=f"{caption_of(column, over, curves)} Dotted: the nearest law of growth, of linear, quadratic "
        f"and exponential ones: {'; '.join(told)}. On the lower axes a power is a straight line, as steep as "
        "its exponent, and an exponential bends upwards.",
        alt=f"Line charts of the mean {heading(column)} over {heading(over)}, on even and on logarithmic "
        f"axes. {ends_of(curves)}. Nearest laws: {'; '.join(told)}.",
    )
