"""Panels with one row per point, whose name stands at the left in the colour of the point."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from bojax.report import style
from bojax.report.source import Point


def set_rows(axes: Axes, points: Sequence[Point], *, bottom: float, ticks: int, name_width: int = 0) -> None:
    """Set the limits and ticks of a panel with one row per point, from the top.

    Args:
        axes: The panel.
        points: The points, one unit of the vertical axis apart.
        bottom: Space below the last row, in rows.
        ticks: Most intervals between ticks of the horizontal axis.
        name_width: Characters per line of a name; names are left out where it is 0.
    """
    names = [style.wrapped(point.name, name_width) for point in points] if name_width else []
    axes.set_yticks(range(len(names)), names)
    for tick, look in zip(axes.get_yticklabels(), style.looks(points), strict=False):
        tick.set_color(look["color"])
    axes.set_ylim(len(points) - 1 + bottom, -0.5)
    axes.spines["left"].set_visible(False)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=ticks))
    style.plain_ticks(axes.xaxis)
    style.quiet_grid(axes, "x")
    axes.tick_params(axis="y", length=0)
