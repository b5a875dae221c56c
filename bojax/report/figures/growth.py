"""How a mean grows with a swept number: Figs. 5.6b and 5.6c of the thesis, with the nearest law of growth."""

from typing import Any

import numpy as np

from bojax.report import style
from bojax.report.drawing.base import Drawing, FigureUnavailable
from bojax.report.drawing.curves import Chart, Curve
from bojax.report.figures.sweep_curve import swept_panel
from bojax.report.growth import LAWS, Fit, errors_of, fit
from bojax.report.source import Results

RANK = 80

_FITTED: dict[str, Any] = {"color": style.INK, "linewidth": 1.1, "linestyle": (0, (2, 2)), "zorder": 1.8}


def draw(results: Results) -> Drawing:
    """The curves of `sweep-curve` with the nearest law of growth, on linear and on logarithmic axes."""
    panel, over, column, note = swept_panel(results)
    laws = [(curve, law) for curve in panel.curves if (law := nearest_law(curve)) is not None]
    if not laws:
        raise FigureUnavailable("a law of growth needs positive means at four values or more")
    chart = Chart([panel, panel], over, is_swept=True)
    linear, logarithmic = chart.axes
    for curve, law in laws:
        x = np.linspace(curve.x[0], curve.x[-1], 200)
        for axes in chart.axes:
            chart.mark(curve, *axes.plot(x, np.where(law(x) > 0, law(x), np.nan), **_FITTED))
    linear.set_ylim(bottom=0)
    logarithmic.set_xscale("log")
    logarithmic.set_yscale("log")
    x = laws[0][0].x
    ticks = x if len(x) <= 8 else x[np.unique(np.geomspace(1, len(x), 6).astype(int)) - 1]
    logarithmic.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    logarithmic.minorticks_off()
    style.plain_ticks(logarithmic.yaxis)
    style.quiet_grid(logarithmic, "both")
    fits = "; ".join(f"{curve.point.name} {law.law}, {law}" for curve, law in laws)
    return chart.drawing(
        f"Growth of {column}",
        "Below: the same on logarithmic axes, where a power law is a straight line whose slope is its "
        "exponent, and an exponential bends upwards. Dotted: the nearest of the linear, quadratic and "
        f"exponential laws: {fits}.",
        note,
    )


def nearest_law(curve: Curve) -> Fit | None:
    """The law of growth nearest to the means; None where these are too few or not positive."""
    if len(curve.x) < 4 or (np.isfinite(curve.values).sum(axis=0) < 2).any():
        return None
    means, errors = np.nanmean(curve.values, axis=0), errors_of(curve.values)
    if not (means > 0).all():
        return None
    return min((fit(law, curve.x, means, errors) for law in LAWS), key=lambda found: found.misfit)
