"""Sketches of a state problem: the true state and states of the belief, as points of a plane or by step."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from bojax.report.columns import Arrays
from bojax.report.drawing.domains import draw_outline, fit_square
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.report.style import BLUE, GREEN, ORANGE, PINK, drawn_text
from bojax.results.outline import Outline

Sketch = Mapping[str, Floats]
"""Points by name, `[steps + 1, 1 + N, P]` with P of 1 or 2: the true state, then N states of the belief."""

_TRAIL = 10
"""Number of past steps whose true states are drawn."""

_COLOURS = (BLUE, ORANGE, GREEN, PINK)


def sketches(results: Results, point: Point) -> dict[int, Sketch]:
    """The recorded sketches of a point, by run."""
    return {run: taken(arrays) for run, arrays in results.arrays(point, "sketch")}


def taken(arrays: Arrays) -> Sketch:
    """The recorded points of the steps that an episode took."""
    return {name: rows[np.isfinite(rows).all(axis=(1, 2))] for name, rows in arrays.items()}


def num_steps(sketch: Sketch) -> int:
    """Number of steps of the episode."""
    return min(len(rows) for rows in sketch.values()) - 1


def is_by_step(sketch: Sketch) -> bool:
    """Whether the sketch has numbers, which are drawn by step, and not points of a plane."""
    return any(rows.shape[-1] == 1 for rows in sketch.values())


def set_stage(axes: Axes, sketch: Sketch, outline: Outline) -> None:
    """Draw the scenery, at limits that show all points of an episode."""
    draw_outline(axes, outline)
    if is_by_step(sketch):
        axes.set_aspect("auto")
        axes.set_xlim(-0.5, num_steps(sketch) + 0.5)
        values = np.concatenate([rows.ravel() for rows in sketch.values()])
        margin = 0.05 * max(float(np.ptp(values)), 1.0)
        axes.set_ylim(values.min() - margin, values.max() + margin)
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=not np.any(values % 1.0)))
        return
    if outline.border is None:
        fit_square(axes, np.concatenate([rows.reshape(-1, 2) for rows in sketch.values()]), 1e-6)
    axes.set_xticks([])
    axes.set_yticks([])


def draw_step(axes: Axes, sketch: Sketch, step: int, size: float = 1.0) -> list[Line2D]:
    """Draw the belief after a step, and the last true states; the result can be removed again."""
    lines: list[Line2D] = []
    for rows, colour in zip(sketch.values(), cycle(_COLOURS), strict=False):
        if is_by_step(sketch):
            steps = np.arange(step + 1.0)
            cloud = np.repeat(steps, rows.shape[1] - 1), rows[: step + 1, 1:, 0].ravel()
            path = np.stack([steps, rows[: step + 1, 0, 0]], axis=-1)
        else:
            cloud, path = rows[step, 1:].T, rows[max(0, step - _TRAIL) : step + 1, 0]
        dots = {"marker": "o", "linestyle": "", "markeredgewidth": 0, "color": colour}
        lines += axes.plot(*cloud, **dots, markersize=3.2 * size, alpha=0.35, zorder=3)
        lines += axes.plot(*path.T, color=colour, linewidth=1.1 * size, alpha=0.6, zorder=4)
        rim = dots | {"markeredgecolor": "white", "markeredgewidth": 1.0 * size}
        lines += axes.plot(*path[-1:].T, **rim, markersize=8.0 * size, zorder=5)
    return lines


def legend_of(all_sketches: Sequence[Sketch]) -> list[tuple[Line2D, str]]:
    """Handle and text of every name, in its colour."""
    entries: dict[str, Line2D] = {}
    for sketch in all_sketches:
        for name, colour in zip(sketch, cycle(_COLOURS), strict=False):
            dot = Line2D([], [], marker="o", linestyle="", color=colour, markersize=6)
            entries.setdefault(drawn_text(name), dot)
    return [(handle, name) for name, handle in entries.items()]
