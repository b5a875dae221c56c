"""Example runs drawn on the domain, some that succeeded and some that failed, one panel per planner."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bojax.report import style
from bojax.report.drawing.base import Drawing, Undrawable, drawn_points, name_panels, panel_grid
from bojax.report.drawing.domains import ARROWS, TARGET, WALL, draw_outline, is_speck, tick_outline
from bojax.report.drawing.maps import QUIET, beliefs, draw_map
from bojax.report.drawing.smooth import driven, smooth
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.report.text import counted

RANK = 120

EXAMPLES = 2
"""Runs of each outcome in a panel; the paths of more runs would cross too often."""

_DASHES = (0, (4, 1.5))
_RED = "#C8102E"
_STOP: dict[str, Any] = {
    "s": 80,
    "facecolors": "none",
    "edgecolors": _RED,
    "linewidths": 1.5,
    "clip_on": False,
}
_RING: dict[str, Any] = {"color": style.INK, "linestyle": "", "marker": "o"}


def draw(results: Results) -> Drawing:
    """The first recorded runs of each outcome; recorded runs are the first of the sweep, not a selection.

    If runs do not end at success, as in monitoring, only the first recorded run is drawn, on the field.
    """
    points, note = drawn_points(results)
    kept = {point.index: list(results.arrays(point, "paths")) for point in points}
    points = tuple(point for point in points if kept[point.index])
    if not points:
        raise Undrawable("no recorded paths in arrays/")
    rows, columns = panel_grid(len(points))
    figure, grid = style.figure(2.34 * rows * 2 / columns + 0.45, rows, columns, sharex=True, sharey=True)
    fields = {point.index: beliefs(results, point) for point in points}
    truths = [belief["truth"] for found in fields.values() for belief in found.values()]
    norm = Normalize(np.min(truths), np.max(truths)) if truths else None
    told, is_outcome_shown, stops, outcomes = [], False, 0, set[bool]()
    for axes, point, look in zip(grid.flat, points, style.looks(points), strict=False):
        draw_outline(axes, point.outline)
        tick_outline(axes, point.outline)
        if point.ends_at_success:
            is_outcome_shown = True
            shown = _outcomes_drawn(axes, results, point, kept[point.index], look["color"])
            outcomes |= {outcome for outcome, count in shown.items() if count}
            told.append(f"{point.name}: {shown[True]} successful and {shown[False]} failed")
        else:
            run, arrays = kept[point.index][0]
            if norm is not None and run in fields[point.index]:
                belief = fields[point.index][run]
                draw_map(axes, belief, belief["truth"], norm, QUIET)
            stopped = _run(axes, arrays, look["color"], is_success=True)
            if len(stopped):
                axes.scatter(*stopped.T, **_STOP, zorder=6)
            stops += len(stopped)
            reached = ""
            if point.has_success:
                reached = f", goal {'' if _outcomes(results, point).get(run) else 'not '}reached"
            told.append(f"{point.name}: run {run}, stopped {counted(len(stopped), 'time')}{reached}")
    name_panels(grid.flat, points)
    for axes in grid[:, 0]:
        axes.set_ylabel("y (m)", labelpad=1)
    for axes in grid[-1]:
        axes.set_xlabel("x (m)", labelpad=1)
    legend = _run_legend(outcomes) if is_outcome_shown else _monitoring_legend(has_stops=stops > 0)
    legend += _domain_legend(points)
    figure.legend(
        *zip(*legend, strict=True),
        handler_map={tuple: HandlerTuple(ndivide=1)},
        loc="outside lower center",
        ncols=4 if is_outcome_shown else 3,
        columnspacing=1.2,
        handletextpad=0.5,
    )
    caption = (
        f"Of the recorded runs, the first {EXAMPLES} that succeeded (in colour) and the first "
        f"{EXAMPLES} that failed (grey, dashed)."
        if is_outcome_shown
        else f"The first recorded run.{' Grey: the true field, darker where higher.' if truths else ''}"
        f"{' Red circles: a wall or the border stopped the robot.' if stops else ''}"
    )
    return Drawing(
        figure=figure,
        title="Example trajectories",
        caption=f"{caption} Arrows show the heading after each step.{note}",
        alt=f"Example trajectories on the domain, one panel per planner. {'; '.join(told)}.",
    )


def _outcomes_drawn(
    axes: Axes, results: Results, point: Point, kept: Sequence[tuple[int, Mapping[str, Any]]], colour: str
) -> dict[bool, int]:
    """Draw the first runs of each outcome, and count them."""
    outcomes, shown = _outcomes(results, point), {True: 0, False: 0}
    for run, arrays in kept:
        succeeded = outcomes.get(run, False)
        if shown[succeeded] < EXAMPLES and "paths" in arrays:
            shown[succeeded] += 1
            _run(axes, arrays, colour if succeeded else style.FAINT, is_success=succeeded)
    return shown


def _outcomes(results: Results, point: Point) -> dict[int, bool]:
    rows = results.runs_of(point)
    success = rows.get("success", np.zeros(rows["run"].size, dtype=bool))
    return {int(run): bool(value) for run, value in zip(rows["run"], success, strict=True)}


def _run(axes: Axes, arrays: Mapping[str, Any], colour: str, *, is_success: bool) -> Floats:
    """Draw a run; the result is the positions `[stops, 2]` at which the robot was stopped."""
    start, steps = driven(arrays)
    if start is None:
        return np.zeros((0, 2))
    ends = [start, *(step[-1] for step in steps)]
    curves = [smooth(begin, step) for begin, step in zip(ends, steps, strict=False)]
    whole = np.concatenate(curves) if curves else start[None, :2]
    line = (
        {"linewidth": 1.4, "zorder": 3}
        if is_success
        else {"linewidth": 1.1, "linestyle": _DASHES, "zorder": 2}
    )
    axes.plot(*whole.T, color=colour, **line)
    axes.scatter(*start[:2], s=22, facecolors="white", edgecolors=colour, linewidths=1.3, zorder=5)
    poses = np.stack([step[-1] for step in steps]) if steps else start[None]
    x, y, heading = poses.T
    shape: dict[str, Any] = {"scale": 1 / 0.075, "width": 0.015, "headlength": 4.6, "headaxislength": 4.2}
    axes.quiver(x, y, np.cos(heading), np.sin(heading), color=colour, zorder=4, **shape, **ARROWS)
    return stops(ends, steps)


def stops(ends: Sequence[Floats], steps: Sequence[Floats]) -> Floats:
    """Positions `[stops, 2]` at which the robot was stopped within a step.

    Args:
        ends: Pose before each step.
        steps: Poses of each step; after the robot is stopped, they repeat.
    """
    last_two = [
        np.concatenate([end[None, :2], step[:, :2]])[-2:] for end, step in zip(ends, steps, strict=False)
    ]
    return np.array([last for before, last in last_two if (before == last).all()]).reshape(-1, 2)


def _monitoring_legend(*, has_stops: bool) -> list[tuple[Any, str]]:
    entries: list[tuple[Any, str]] = [
        (Line2D([], [], color=style.INK, linewidth=1.4), "path"),
        (Line2D([], [], **_RING, markersize=5, markerfacecolor="white"), "start"),
    ]
    if has_stops:
        red = {"markeredgecolor": _RED, "markerfacecolor": "none", "markeredgewidth": 1.5}
        entries.append((Line2D([], [], linestyle="", marker="o", markersize=8, **red), "stopped"))
    return entries


def _run_legend(outcomes: set[bool]) -> list[tuple[Any, str]]:
    entries: list[tuple[Any, str]] = []
    if True in outcomes:
        entries.append((Line2D([], [], color=style.INK, linewidth=1.4), "success"))
    if False in outcomes:
        entries.append((Line2D([], [], color=style.FAINT, linewidth=1.1, linestyle=_DASHES), "failure"))
    return [*entries, (Line2D([], [], **_RING, markersize=5, markerfacecolor="white"), "start")]


def _domain_legend(points: Sequence[Point]) -> list[tuple[Any, str]]:
    """Entries for the shapes of the domains."""
    entries: list[tuple[Any, str]] = []
    if any(point.outline.obstacles for point in points):
        entries.append((Patch(facecolor=WALL), "obstacle"))
    specks = {is_speck(point.outline, shape) for point in points for shape in point.outline.goals}
    if True in specks:
        ring = Line2D([], [], **_RING, markersize=9, markerfacecolor="none")
        entries.append(((ring, Line2D([], [], **_RING, markersize=2.5)), "goal"))
    if False in specks:
        entries.append((Patch(**TARGET), "goal"))
    return entries
