"""Curves by step with their bands: the common part of the figures over steps."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from bojax.report import style
from bojax.report.source import Point
from bojax.report.statistics import Floats

_MAX_DIRECT = 9
_MAX_NAME = 14
"""More or longer names than this go below the figure: beside the curves they would take its width."""


def draw_curves(
    points: Sequence[Point],
    curves: Mapping[int, tuple[Floats, Floats, Floats]],
    ylabel: str,
    *,
    is_share: bool = False,
) -> Figure:
    """One curve per point over steps from 0 on, with its band and its name at the right end.

    Args:
        points: What to draw.
        curves: Mean, lower and upper bound by step, by point index.
        ylabel: Label of the vertical axis, with its unit.
        is_share: Whether the values are shares of 1, drawn as percentages from 0 to 100.
    """
    rows_below = len(points) // 2 if max(len(point.name) for point in points) > _MAX_NAME else 0
    figure, grid = style.figure(3.6 + 0.2 * rows_below)
    axes = grid[0, 0]
    looks = style.looks(points)
    last = 0
    for point, look in zip(points, looks, strict=True):
        mean, low, high = curves[point.index]
        last = len(mean) - 1
        axes.fill_between(range(last + 1), low, high, color=look["color"], alpha=0.16, linewidth=0)
        axes.plot(range(last + 1), mean, label=point.name, **look)
    axes.set_xlim(0, max(last, 1))
    axes.set_xticks(step_ticks(last))
    if is_share:
        axes.set_ylim(0, 1)
        axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "25", "50", "75", "100"])
    else:
        axes.axhline(0, color="#9A9A9A", linewidth=0.8, zorder=0.5)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.10g}".replace("-", "\N{MINUS SIGN}"))
    axes.set_xlabel("step")
    axes.set_ylabel(ylabel)
    style.quiet_grid(axes)
    names = [point.name for point in points]
    if len(points) > _MAX_DIRECT or max(map(len, names)) > _MAX_NAME:
        figure.legend(loc="outside lower center", ncols=1 if max(map(len, names)) > 24 else 2)
        return figure
    ends = [float(curves[point.index][0][-1]) for point in points]
    style.direct_labels(axes, last, ends, names, [look["color"] for look in looks])
    return figure


def step_ticks(last: int, most: int = 9) -> list[int]:
    """Evenly spaced whole steps from 0, the last one among them where the spacing allows it."""
    spacings = [factor * 10**power for power in range(9) for factor in (1, 2, 3, 5)]
    few = [spacing for spacing in spacings if last // spacing < most]
    spacing = next((spacing for spacing in few[:3] if last % spacing == 0), few[0])
    return list(range(0, last + 1, spacing))
