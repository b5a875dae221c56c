"""Panels of a search: the best value so far, and a slice of the model along an axis. Imports no JAX."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from bojax.optimisation.space import Axis, Choice
from bojax.report import style
from bojax.report.statistics import BAND

_DOTS: Mapping[str, Any] = {"color": style.GREY, "markeredgewidth": 0}


def draw_progress(
    axes: Axes, values: Sequence[float | None], is_maximised: bool, numbers: Sequence[int] | None = None
) -> np.ndarray:
    """Draw all values in order, and return the best one so far at each; None and NaN are failures."""
    found = np.asarray([np.nan if value is None or not np.isfinite(value) else value for value in values])
    at = np.arange(1, len(found) + 1) if numbers is None else np.asarray(numbers)
    best = (np.fmax if is_maximised else np.fmin).accumulate(found)
    axes.plot(at, found, "o", **_DOTS, markersize=3.5, alpha=0.6)
    axes.step(at, best, where="post", color=style.BLUE)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=4, integer=True))
    finish(axes)
    return best


def draw_slice(
    axes: Axes,
    axis: Axis,
    curve: tuple[Sequence[Any], Sequence[float], Sequence[float]],
    told: tuple[Sequence[Any], Sequence[float]],
    best: tuple[Any, float],
) -> None:
    """Draw the mean of the model along an axis and its 95% interval, all values, and the best point.

    Args:
        axes: Where to draw.
        axis: The axis.
        curve: Values of the axis in order, and the mean and the standard deviation of the model there.
        told: Values of the axis at all evaluations, and what was found.
        best: The value of the axis at the best point, and what is shown there.
    """
    x, mean, std = curve[0], np.asarray(curve[1]), np.asarray(curve[2])
    places, chosen = told[0], best[0]
    if isinstance(axis, Choice):
        x, (*places, chosen) = range(len(x)), [axis.values.index(value) for value in (*places, chosen)]
        axes.errorbar(x, mean, BAND * std, fmt="_", color=style.BLUE, markersize=14)
        axes.set_xticks(x, [style.wrapped(str(value), 12) for value in axis.values])
        axes.margins(x=0.15)
    else:
        axes.fill_between(x, mean - BAND * std, mean + BAND * std, color=style.BLUE, alpha=0.18, linewidth=0)
        axes.plot(x, mean, color=style.BLUE)
    axes.plot(places, told[1], "o", **_DOTS, markersize=3, alpha=0.5)
    axes.plot([chosen], [best[1]], "D", color=style.ORANGE, markersize=6)
    if isinstance(axis, Choice):
        style.plain_ticks(axes.yaxis)
        style.quiet_grid(axes)
    else:
        if axis.is_log:
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=_ticks(axis.low, axis.high)))
            axes.xaxis.set_minor_formatter(NullFormatter())
        else:
            axes.xaxis.set_major_locator(MaxNLocator(nbins=4, integer=axis.is_integer))
        finish(axes)
    axes.set_xlabel(style.wrapped(axis.key, 22))


def finish(axes: Axes) -> None:
    """Plain numbers at the ticks, and a quiet grid."""
    for axis in (axes.xaxis, axes.yaxis):
        style.plain_ticks(axis)
    style.quiet_grid(axes)


def _ticks(low: float, high: float) -> tuple[float, ...]:
    """Leading digits of the ticks of a logarithmic axis: more of them over a short range."""
    return (1.0,) if high / low > 100.0 else (1.0, 3.0) if high / low > 10.0 else (1.0, 2.0, 5.0)
