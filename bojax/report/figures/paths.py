"""Example runs drawn on the domain, some that succeeded and some that failed, one panel per planner."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D

from bojax.report import style
from bojax.report.figures.base import Drawing, Undrawable, drawn_points, panel_grid
from bojax.report.figures.domains import DOMAINS
from bojax.report.figures.smooth import smooth
from bojax.report.source import Point, Results

EXAMPLES = 2
"""Runs of each outcome in a panel: more cross too often to be followed."""


_DASHES = (0, (4, 1.5))


def draw(results: Results) -> Drawing:
    """The first recorded runs of each outcome; recorded runs are the first of the sweep, not a choice."""
    points, note = drawn_points(results)
    kept = {point.index: list(results.arrays(point, "paths")) for point in points}
    points = tuple(point for point in points if kept[point.index])
    if not points:
        raise Undrawable("no recorded paths in arrays/")
    rows, columns = panel_grid(len(points))
    figure, grid = style.figure(2.34 * rows * 2 / columns + 0.45, rows, columns, sharex=True, sharey=True)
    told = []
    for axes, point, look in zip(grid.flat, points, style.looks(points), strict=False):
        outcomes = _outcomes(results, point)
        shown = {True: 0, False: 0}
        problem = point.config.get("problem")
        if isinstance(problem, Mapping) and problem.get("kind") in DOMAINS:
            DOMAINS[str(problem["kind"])](axes, problem)
        for run, arrays in kept[point.index]:
            succeeded = outcomes.get(run, False)
            if shown[succeeded] < EXAMPLES and "paths" in arrays:
                shown[succeeded] += 1
                _run(axes, arrays, look["color"] if succeeded else style.FAINT, is_success=succeeded)
        told.append(f"{point.name}: {shown[True]} successful and {shown[False]} failed")
        axes.set_title(style.wrapped(point.name, 24), color=look["color"], pad=4)
        axes.set_aspect("equal")
        axes.tick_params(length=0)
        for side in axes.spines.values():
            side.set_visible(False)
    for axes in grid.flat[len(points) :]:
        axes.set_visible(False)
    for axes in grid[:, 0]:
        axes.set_ylabel("y (m)", labelpad=1)
    for axes in grid[-1]:
        axes.set_xlabel("x (m)", labelpad=1)
    figure.legend(
        *zip(*_legend(), strict=True),
        handler_map={tuple: HandlerTuple(ndivide=1)},
        loc="outside lower center",
        ncols=4,
        columnspacing=1.2,
        handletextpad=0.5,
    )
    return Drawing(
        figure=figure,
        title="Example trajectories",
        caption=f"Of the recorded runs, the first {EXAMPLES} that succeeded (in colour) and the first "
        f"{EXAMPLES} that failed (grey, dashed). Arrows show the heading after each step.{note}",
        alt=f"Example trajectories on the domain, one panel per planner. {'; '.join(told)}.",
    )


def _outcomes(results: Results, point: Point) -> dict[int, bool]:
    rows = results.runs_of(point)
    success = rows.get("success", np.zeros(rows["run"].size, dtype=bool))
    return {int(run): bool(value) for run, value in zip(rows["run"], success, strict=True)}


def _run(axes: Axes, arrays: Mapping[str, Any], colour: str, *, is_success: bool) -> None:
    samples = [step[np.isfinite(step).all(axis=1)] for step in np.asarray(arrays["paths"], dtype=np.float64)]
    steps = [step for step in samples if len(step)]
    start = np.asarray(arrays["start"], dtype=np.float64) if "start" in arrays else None
    if start is None and steps:
        start = steps[0][0]
    if start is None:
        return
    ends = [start, *(step[-1] for step in steps)]
    curves = [smooth(begin, step) for begin, step in zip(ends, steps, strict=False)]
    whole = np.concatenate(curves) if curves else start[None, :2]
    line = "-" if is_success else _DASHES
    axes.plot(
        whole[:, 0],
        whole[:, 1],
        color=colour,
        linewidth=1.4 if is_success else 1.1,
        linestyle=line,
        zorder=3 if is_success else 2,
    )
    axes.scatter(*start[:2], s=22, facecolors="white", edgecolors=colour, linewidths=1.3, zorder=5)
    poses = np.stack([step[-1] for step in steps]) if steps else start[None]
    axes.quiver(
        poses[:, 0],
        poses[:, 1],
        np.cos(poses[:, 2]),
        np.sin(poses[:, 2]),
        color=colour,
        pivot="mid",
        angles="uv",
        units="inches",
        scale_units="inches",
        scale=1 / 0.075,
        width=0.015,
        headwidth=5,
        headlength=4.6,
        headaxislength=4.2,
        zorder=4,
    )


def _legend() -> list[tuple[Any, str]]:
    ring: dict[str, Any] = {"color": style.INK, "linestyle": "", "marker": "o"}
    goal = (
        Line2D([], [], **ring, markersize=9, markerfacecolor="none"),
        Line2D([], [], **ring, markersize=2.5),
    )
    return [
        (Line2D([], [], color=style.INK, linewidth=1.4), "success"),
        (Line2D([], [], color=style.FAINT, linewidth=1.1, linestyle=_DASHES), "failure"),
        (Line2D([], [], **ring, markersize=5, markerfacecolor="white"), "start"),
        (goal, "goal"),
    ]
