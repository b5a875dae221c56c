"""The outline of a world, drawn on axes in metres."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Patch, PathPatch, Rectangle
from matplotlib.path import Path

from bojax.report import style
from bojax.report.text import minus
from bojax.results.outline import Outline

FLOOR, WALL, EDGE = "#F6F6F4", "#4A4A4A", "#555555"

TARGET: Mapping[str, Any] = {"facecolor": "none", "edgecolor": style.INK, "linestyle": (0, (2, 1.5))}
"""Style of a goal area."""

ARROWS: Mapping[str, Any] = {"units": "inches", "scale_units": "inches", "pivot": "mid", "headwidth": 5}
"""Style of arrows that show headings."""

_SPECK = 0.05
"""Radius of a goal, as a share of the side of the domain, up to which it is drawn as a dot in a ring."""


def draw_outline(axes: Axes, outline: Outline) -> None:
    """Draw the world of a problem at equal scale, without a box around the axes."""
    border = None
    if outline.border is not None:
        x_min, y_min, x_max, y_max = outline.border
        margin = 0.04 * max(x_max - x_min, y_max - y_min)
        axes.set_xlim(x_min - margin, x_max + margin)
        axes.set_ylim(y_min - margin, y_max + margin)
        axes.add_patch(_shape(outline.border, facecolor=FLOOR, edgecolor="none", zorder=0))
        # The border covers the ends of maps and walls.
        border = _shape(outline.border, facecolor="none", edgecolor=EDGE, linewidth=1.1, zorder=2.6)
        axes.add_patch(border)
    for shape in outline.obstacles:
        patch = axes.add_patch(_shape(shape, facecolor=WALL, edgecolor="none", zorder=2.5))
        if border is not None:
            patch.set_clip_path(border)
    if len(outline.area) > 0 and border is not None:
        patch = axes.add_patch(PathPatch(_outside(outline), facecolor=WALL, edgecolor="none", zorder=2.45))
        patch.set_clip_path(border)
    for shape in outline.goals:
        _draw_goal(axes, outline, shape)
    if outline.start is not None:
        rim = {"facecolors": "white", "edgecolors": style.INK, "linewidths": 1.3}
        axes.scatter(*outline.start, s=22, **rim, zorder=4.5)
    axes.set_aspect("equal")
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)


def _outside(outline: Outline) -> Path:
    """The border less the area."""
    assert outline.border is not None
    x_min, y_min, x_max, y_max = outline.border
    rings = [[(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)], *outline.area]
    paths = [Path([*ring, ring[0]], closed=True) for ring in rings]
    # Matplotlib fills by winding numbers: borders of areas and those of their holes must turn in opposite
    # directions.
    for index, ring in enumerate(rings[1:], start=1):
        depth = 1 + sum(each.contains_point(ring[0]) for each in paths[1:] if each is not paths[index])
        x, y = np.asarray(ring, float).T
        is_counter_clockwise = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0.0
        if is_counter_clockwise == (depth % 2 == 1):
            paths[index] = Path([*ring[::-1], ring[-1]], closed=True)
    return Path.make_compound_path(*paths)


def tick_outline(axes: Axes, outline: Outline) -> None:
    """Set ticks at the ends and in the middle of a domain with a border."""
    if outline.border is not None:
        x_min, y_min, x_max, y_max = outline.border
        for axis, low, high in ((axes.xaxis, x_min, x_max), (axes.yaxis, y_min, y_max)):
            places = (low, 0.5 * (low + high), high)
            axis.set_ticks(places, [minus(f"{place:g}") for place in places])


def fit_square(axes: Axes, points: np.ndarray, least: float) -> None:
    """Set square limits that show points `[N, 2]` and the shapes of a world without a border.

    Without a margin, the square has a side of `least` or more.
    """
    if axes.patches:  # obstacles and goals
        points = np.concatenate([points, axes.dataLim.get_points()])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    half = 0.55 * max(float(np.ptp(points, axis=0).max()), least)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)


def is_speck(outline: Outline, shape: Sequence[float]) -> bool:
    """Whether a goal is a disc too small to be seen on the scale of the domain."""
    if outline.border is None or len(shape) != 3:
        return False
    x_min, y_min, x_max, y_max = outline.border
    return shape[2] <= _SPECK * max(x_max - x_min, y_max - y_min)


def _draw_goal(axes: Axes, outline: Outline, shape: Sequence[float]) -> None:
    if is_speck(outline, shape):
        axes.add_patch(_shape(shape, facecolor=style.INK, edgecolor="none", zorder=6))
        ring = {"facecolors": "none", "edgecolors": style.INK, "linewidths": 1.0}
        axes.scatter(*shape[:2], s=85, **ring, zorder=6)
        return
    if len(shape) == 4 and outline.border is not None:  # inset, since a goal often shares the border
        inset = 0.012 * (outline.border[2] - outline.border[0])
        shape = (shape[0] + inset, shape[1] + inset, shape[2] - inset, shape[3] - inset)
    axes.add_patch(_shape(shape, **TARGET, linewidth=1.0, zorder=2.4))


def _shape(numbers: Sequence[float], **options: Any) -> Patch:
    if len(numbers) == 3:
        return Circle((numbers[0], numbers[1]), numbers[2], **options)
    x_min, y_min, x_max, y_max = numbers
    return Rectangle((x_min, y_min), x_max - x_min, y_max - y_min, **options)
