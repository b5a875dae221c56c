"""Paths, a panel for each point: example runs on the domain, and the trajectories of a motion family."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bojax.problems.settings import FieldProblem
from bojax.report import style
from bojax.report.drawing.base import Drawing, label_panels, name_panels, panel_grid, points_with
from bojax.report.drawing.domains import ARROWS, TARGET, WALL, draw_outline, is_speck, tick_outline
from bojax.report.drawing.maps import QUIET, beliefs, draw_map
from bojax.report.drawing.smooth import driven, smooth
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.report.text import counted

EXAMPLES = 2  # runs of each outcome in a panel; the paths of more runs would cross too often

_DASHES = (0, (4, 1.5))
_RED = "#C8102E"
_STOP: dict[str, Any] = {"facecolors": "none", "edgecolors": _RED, "linewidths": 1.5, "clip_on": False}
_RING: dict[str, Any] = {"color": style.INK, "linestyle": "", "marker": "o"}


def paths(results: Results) -> Drawing:
    """The first recorded runs of each outcome; recorded runs are the first of the sweep, not a selection.

    If runs do not end at success, as in monitoring, only the first recorded run is drawn, on the field.
    """
    found, note = points_with(
        results, lambda point: dict(results.arrays(point, "paths")), "no recorded paths in arrays/"
    )
    points, recorded = [point for point, _ in found], [runs for _, runs in found]
    options: dict[str, Any] = {"sharex": True, "sharey": True}
    figure, grid = panel_grid(len(points), lambda columns: 4.68 / columns, 0.45, **options)
    fields = {point.index: beliefs(results, point) for point in points}
    truths = [belief["truth"] for found in fields.values() for belief in found.values()]
    norm = Normalize(np.min(truths), np.max(truths)) if truths else None
    told, is_outcome_shown, num_stops, outcomes = [], False, 0, set[bool]()
    for axes, point, runs, look in zip(grid.flat, points, recorded, style.looks(points), strict=False):
        draw_outline(axes, point.outline)
        tick_outline(axes, point.outline)
        table = results.runs_of(point)
        succeeded = set(table["run"][table["success"].astype(bool)].tolist() if "success" in table else ())
        if point.ends_at_success:
            is_outcome_shown, shown = True, {True: 0, False: 0}
            for run, arrays in runs.items():
                if shown[is_success := run in succeeded] < EXAMPLES:
                    shown[is_success] += 1
                    _draw_run(axes, arrays, look["color"] if is_success else style.FAINT, is_success)
            outcomes |= {is_success for is_success, count in shown.items() if count}
            told.append(f"{point.name}: {shown[True]} successful and {shown[False]} failed")
            continue
        run, arrays = next(iter(runs.items()))
        if norm is not None and run in fields[point.index]:
            belief = fields[point.index][run]
            draw_map(axes, belief, belief["truth"], norm, QUIET)
        stopped = _draw_run(axes, arrays, look["color"])
        if len(stopped):
            axes.scatter(*stopped.T, s=80, **_STOP, zorder=6)
        num_stops += len(stopped)
        reached = f", goal {'' if run in succeeded else 'not '}reached" if point.has_success else ""
        told.append(f"{point.name}: run {run}, stopped {counted(len(stopped), 'time')}{reached}")
    name_panels(grid.flat, points)
    label_panels(grid, "x (m)", "y (m)", labelpad=1)
    entries = _legend(points, outcomes if is_outcome_shown else None, has_stops=num_stops > 0)
    columns = {"ncols": 4 if is_outcome_shown else 3, "columnspacing": 1.2, "handletextpad": 0.5}
    pairs = {tuple: HandlerTuple(ndivide=1)}
    figure.legend(*zip(*entries, strict=True), handler_map=pairs, loc="outside lower center", **columns)
    caption = (
        f"Of the recorded runs, the first {EXAMPLES} that succeeded (in colour) and the first "
        f"{EXAMPLES} that failed (grey, dashed)."
        if is_outcome_shown
        else f"The first recorded run.{' Grey: the true field, darker where higher.' if truths else ''}"
        f"{f' Red circles: {_stoppers(points)} stopped the robot.' if num_stops else ''}"
    )
    return Drawing(
        figure=figure,
        title="Example trajectories",
        caption=f"{caption} Arrows show the heading after each step.{note}",
        alt=f"Example trajectories on the domain, one panel per planner. {'; '.join(told)}.",
    )


def _stoppers(points: Sequence[Point]) -> str:
    problems = [point.problem for point in points]
    has_budget = any(isinstance(each, FieldProblem) and each.distance_budget is not None for each in problems)
    return "a wall, the border or the end of the budget" if has_budget else "a wall or the border"


def _draw_run(axes: Axes, arrays: Mapping[str, Any], colour: str, is_success: bool = True) -> Floats:
    """Draw a run; the result is the positions `[stops, 2]` at which the robot was stopped."""
    ends, steps, curve = driven(arrays)
    if not ends:
        return curve
    line: dict[str, Any] = {"linewidth": 1.4, "zorder": 3}
    if not is_success:
        line = {"linewidth": 1.1, "linestyle": _DASHES, "zorder": 2}
    axes.plot(*curve.T, color=colour, **line)
    axes.scatter(*ends[0][:2], s=22, facecolors="white", edgecolors=colour, linewidths=1.3, zorder=5)
    x, y, heading = np.stack(ends[1:] or ends).T
    shape: dict[str, Any] = {"scale": 1 / 0.075, "width": 0.015, "headlength": 4.6, "headaxislength": 4.2}
    axes.quiver(x, y, np.cos(heading), np.sin(heading), color=colour, zorder=4, **shape, **ARROWS)
    return stops(ends, steps)


def stops(ends: Sequence[Floats], steps: Sequence[Floats]) -> Floats:
    """Positions `[stops, 2]` at which the robot was stopped within a step, so that its poses repeat."""
    pairs = zip(ends, steps, strict=False)
    last_two = [np.concatenate([end[None, :2], step[:, :2]])[-2:] for end, step in pairs]
    return np.array([last for before, last in last_two if (before == last).all()]).reshape(-1, 2)


def _legend(points: Sequence[Point], outcomes: set[bool] | None, *, has_stops: bool) -> list[tuple[Any, str]]:
    """Entries for paths, by outcome or None, and for the shapes of the domains."""
    has_walls = any(each.outline.obstacles or each.outline.area for each in points)
    specks = {is_speck(point.outline, shape) for point in points for shape in point.outline.goals}
    line = Line2D([], [], color=style.INK, linewidth=1.4)
    failure = Line2D([], [], color=style.FAINT, linewidth=1.1, linestyle=_DASHES)
    red = {"markeredgecolor": _RED, "markerfacecolor": "none", "markeredgewidth": 1.5}
    ring = Line2D([], [], **_RING, markersize=9, markerfacecolor="none")
    stopped = Line2D([], [], linestyle="", marker="o", markersize=8, **red)
    entries = [
        (outcomes is None, line, "path"),
        (True in (outcomes or ()), line, "success"),
        (False in (outcomes or ()), failure, "failure"),
        (True, Line2D([], [], **_RING, markersize=5, markerfacecolor="white"), "start"),
        (has_stops and outcomes is None, stopped, "stopped"),
        (has_walls, Patch(facecolor=WALL), "obstacle"),
        (True in specks, (ring, Line2D([], [], **_RING, markersize=2.5)), "goal"),
        (False in specks, Patch(**TARGET), "goal"),
    ]
    return [(handle, text) for is_shown, handle, text in entries if is_shown]


def trajectories(results: Results) -> Drawing:
    """All trajectories of the first run of each point, from the origin (Fig. 4.2 of the thesis)."""
    found, note = points_with(
        results,
        lambda point: {
            run: np.asarray(arrays["paths"], dtype=np.float64)
            for run, arrays in results.arrays(point, "trajectories")
            if run == 0 and "paths" in arrays
        },
        "no trajectories in arrays/",
    )
    points, families = [point for point, _ in found], [kept[0] for _, kept in found]
    everything = np.concatenate([each[..., :2].reshape(-1, 2) for each in families])
    low = np.minimum(np.nanmin(everything, axis=0), -0.05)
    high = np.maximum(np.nanmax(everything, axis=0), 0.05)
    margin = 0.08 * float((high - low).max())
    shape = float((high[1] - low[1] + 2 * margin) / (high[0] - low[0] + 2 * margin))

    def height(columns: int) -> float:
        return min((style.WIDTH - 0.6) / columns * shape, 4.0) + 0.3

    figure, grid = panel_grid(len(points), height, 0.4, sharex=True, sharey=True)
    arrow: dict[str, Any] = {"scale": 1 / 0.2, "width": 0.03, "headlength": 4.5, "headaxislength": 4}
    names = style.drawn_names(points)
    for axes, name, each, look in zip(grid.flat, names, families, style.looks(points), strict=False):
        for path in each:
            curve = smooth(np.zeros(2), path)
            axes.plot(curve[:, 0], curve[:, 1], color=look["color"], linewidth=1.3)
        axes.quiver([0], [0], [1], [0], color=style.INK, zorder=5, **ARROWS, **arrow)
        axes.set_title(style.wrapped(name, 24), pad=4)
        axes.set_aspect("equal")
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
        axes.locator_params(nbins=5)
        style.quiet_grid(axes, "both")
    label_panels(grid, "x (m)", "y (m)")
    counts = [counted(len(each), "path") for each in families]
    panels = "; ".join(f"{point.name}, {count}" for point, count in zip(points, counts, strict=True))
    return Drawing(
        figure=figure,
        title="Trajectories",
        caption=f"The robot is at the origin and heads right (arrow).{note}",
        alt=f"Trajectories from the origin, one panel per setting: {panels}.",
    )
