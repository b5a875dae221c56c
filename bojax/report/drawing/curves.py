"""Curves with their bands, over steps or episodes: the common part of the figures over them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bojax.report import style
from bojax.report.source import Point
from bojax.report.statistics import Floats

Band = tuple[Floats, Floats, Floats]
"""Mean, lower and upper bound."""

_MAX_DIRECT = 9
_MAX_NAME = 14
"""More or longer names than this go below the figure: beside the curves they would take its width."""


def draw_curves(
    points: Sequence[Point],
    curves: Mapping[int, Band],
    ylabel: str,
    *,
    xlabel: str = "step",
    first: int = 0,
    is_share: bool = False,
) -> Figure:
    """One curve per point, with its band and its name at the right end.

    Args:
        points: What to draw.
        curves: Mean, lower and upper bound by step or episode, by point index.
        ylabel: Label of the vertical axis, with its unit.
        xlabel: Label of the horizontal axis.
        first: Number of the first step or episode of the curves.
        is_share: Whether the values are shares of 1, drawn as percentages from 0 to 100.
    """
    figure, grid = curve_figure(points, 1)
    add_curves(grid[0, 0], points, curves, ylabel, first=first, is_share=is_share)
    grid[0, 0].set_xlabel(xlabel)
    add_names(figure, grid[0, 0], points, curves)
    return figure


def curve_figure(points: Sequence[Point], rows: int) -> tuple[Figure, np.ndarray]:
    """A figure for panels of curves, one above the other, with room for names below where they are long."""
    rows_below = len(points) // 2 if _longest(points) > _MAX_NAME else 0
    height = 3.6 if rows == 1 else 0.5 + 2.4 * rows
    return style.figure(height + 0.2 * rows_below, rows, sharex=True)


def add_curves(
    axes: Axes,
    points: Sequence[Point],
    curves: Mapping[int, Band],
    ylabel: str,
    *,
    first: int = 0,
    is_share: bool = False,
) -> None:
    """The curves of the points, with their bands, in one panel; all have the same length."""
    last = first
    for point, look in zip(points, style.looks(points), strict=True):
        mean, low, high = curves[point.index]
        x = np.arange(first, first + len(mean))
        last = int(x[-1])
        axes.fill_between(x, low, high, color=look["color"], alpha=0.16, linewidth=0)
        # A value without neighbours has no line: then it is a dot.
        dots: dict[str, Any] = {"marker": "o", "markersize": 3} if len(mean) < 3 else {}
        axes.plot(x, mean, label=point.name, **look, **dots)
    axes.set_xlim(min(first, last - 1), max(last, 1))
    axes.set_xticks([tick for tick in step_ticks(last) if tick >= first])
    if is_share:
        axes.set_ylim(0, 1)
        axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "25", "50", "75", "100"])
    else:
        axes.axhline(0, color="#9A9A9A", linewidth=0.8, zorder=0.5)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.10g}".replace("-", "\N{MINUS SIGN}"))
    axes.set_ylabel(ylabel)
    style.quiet_grid(axes)


def add_names(figure: Figure, axes: Axes, points: Sequence[Point], curves: Mapping[int, Band]) -> None:
    """Names of the curves beside their right ends in a panel, or below the figure where they are long."""
    if len(points) > _MAX_DIRECT or _longest(points) > _MAX_NAME:
        handles, names = axes.get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=1 if _longest(points) > 24 else 2)
        return
    ends = [_end(curves[point.index][0]) for point in points]
    names = [point.name for point in points]
    inks = [look["color"] for look in style.looks(points)]
    style.direct_labels(axes, axes.get_xlim()[1], ends, names, inks)


def step_ticks(last: int, most: int = 9) -> list[int]:
    """Evenly spaced whole steps from 0, the last one among them where the spacing allows it."""
    spacings = [factor * 10**power for power in range(9) for factor in (1, 2, 3, 5)]
    few = [spacing for spacing in spacings if last // spacing < most]
    spacing = next((spacing for spacing in few[:3] if last % spacing == 0), few[0])
    return list(range(0, last + 1, spacing))


def _longest(points: Sequence[Point]) -> int:
    return max(len(point.name) for point in points)


def _end(mean: Floats) -> float:
    known = mean[np.isfinite(mean)]
    return float(known[-1]) if known.size else 0.0
