"""Figures of a league: ratios of errors, and routes."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bojax.report import style
from bojax.report.drawing.base import Drawing
from bojax.report.league.aims import MISSED, OPEN, REACHED, Aim, Comparison
from bojax.report.text import counted, number

DRAWN, TICKS = (0.45, 2.2), (0.5, 0.7, 1.0, 1.4, 2.0)
"""Limits and ticks of the axis of ratios."""

COLOURS = {REACHED: style.BLUE, OPEN: style.GREY, MISSED: style.ORANGE}
"""Colours of verdicts."""


def draw_ratios(judged: Sequence[Aim]) -> Drawing:
    """Every comparison behind an aim, with the bound that the aim sets."""
    rows = [(each, comparison) for each in judged for comparison in each.comparisons]
    figure, grid = style.figure(0.9 + 0.23 * len(rows))
    axes = grid[0, 0]
    for row, (each, comparison) in enumerate(rows):
        ratio, colour = comparison.ratio, COLOURS[comparison.verdict]
        axes.plot([ratio.low, ratio.high], [row, row], color=colour, linewidth=2)
        axes.scatter([ratio.estimate], [row], s=20, color=colour, zorder=3)
        axes.plot([each.bound, each.bound], [row - 0.5, row + 0.5], color=style.INK, linewidth=0.9)
    axes.set_yticks(range(len(rows)), [_heading(*row) for row in rows], fontsize=7.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    style.quiet_grid(axes, "x")
    axes.set_xscale("log")
    axes.set_xlim(*DRAWN)
    axes.set_xticks(TICKS, [f"{100 * (tick - 1):+.0f}%".replace("+0%", "0%") for tick in TICKS])
    axes.minorticks_off()
    axes.set_xlabel("error against the rival's")
    return Drawing(
        figure,
        "Errors relative to the rivals'",
        "Ratio of sums of errors with its 95% interval over starts; the vertical line is the bound of the "
        "aim. Blue: within it; orange: beyond it; grey: not told apart by these starts. Some intervals are "
        "longer than the axis.",
        f"{counted(len(rows), 'ratio')} of errors with intervals.",
    )


def draw_routes(routes: Mapping[str, Any], title: str) -> Drawing:
    """The routes of each method from one start, in a panel each."""
    columns = 3
    figure, grid = style.figure(1.75 * -(-len(routes) // columns), -(-len(routes) // columns), columns)
    for axes in grid.flat[len(routes) :]:
        axes.set_visible(False)
    for axes, (method, waypoints) in zip(grid.flat, routes.items(), strict=False):
        route = np.asarray(waypoints)
        axes.plot(*route.T, color=style.BLUE, linewidth=1.0)
        axes.plot(*route[0], marker="o", color=style.BLUE, markersize=4)
        axes.set_title(style.wrapped(method, 18), fontsize=8.5)
        axes.set_aspect("equal")
        axes.set_xlim(0.0, 10.0)
        axes.set_ylim(0.0, 10.0)
        axes.set_xticks([])
        axes.set_yticks([])
    return Drawing(figure, "Routes", title, f"Routes of {counted(len(routes), 'method')} from one start.")


def _heading(each: Aim, comparison: Comparison) -> str:
    where = f", {comparison.where}" if comparison.where else ""
    return f"{each.short}{where}: {comparison.rival.replace('lawnmower from a corner', 'corner')}"


def in_words(comparison: Comparison) -> str:
    """The ratio as a change in percent, with its interval."""
    ratio = comparison.ratio
    if not np.isfinite([ratio.low, ratio.high]).all():
        return f"{100 * (ratio.estimate - 1):+.1f}%"
    low, high = (number(round(100 * (bound - 1), 1)) for bound in (ratio.low, ratio.high))
    return f"{100 * (ratio.estimate - 1):+.1f}% [{low}, {high}]"
