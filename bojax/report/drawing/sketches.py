"""Sketches of a state problem: the true state and states of the belief, as points of a plane or by step."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from bojax.report.columns import Arrays
from bojax.report.drawing.curves import step_ticks
from bojax.report.drawing.domains import draw_outline, fit_square
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.report.style import BLUE, GREEN, ORANGE, PINK, drawn_text
from bojax.results.outline import Outline

Sketch = Mapping[str, Floats]
"""Points by name, `[steps + 1, 1 + N, P]` with P of 1 or 2: the true state, then N states of the belief."""

_TRAIL = 10
"""Number of past steps whose true states are drawn."""

_WIDEST, _MOST = 4.0, 170.0
"""Most widths of a single state's dot in that of equal states, and in those of all steps side by side."""

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
        axes.set_xticks(step_ticks(num_steps(sketch)))
        values = np.concatenate([rows.ravel() for rows in sketch.values()])
        margin = 0.05 * max(float(np.ptp(values)), 1.0)
        axes.set_ylim(values.min() - margin, values.max() + margin)
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=not np.any(values % 1.0)))
        return
    if outline.border is None:
        fit_square(axes, np.concatenate([rows.reshape(-1, 2) for rows in sketch.values()]), 1e-6)
    axes.set_xticks([])
    axes.set_yticks([])


def draw_step(axes: Axes, sketch: Sketch, step: int, size: float = 1.0) -> list[Artist]:
    """Draw the belief after a step, and the last true states; the result can be removed again."""
    drawn: list[Artist] = []
    by_step = is_by_step(sketch)
    for rows, colour in zip(sketch.values(), cycle(_COLOURS), strict=False):
        path = rows[max(0, step - _TRAIL) : step + 1, 0]
        widest = _WIDEST
        if by_step:
            rows = rows[..., :1]
            path = np.stack([np.arange(step + 1.0), rows[: step + 1, 0, 0]], axis=-1)
            widest = min(widest, max(1.0, _MOST / size / len(rows)))
        spots, counts, areas = _spots(rows, widest)
        now = spots[:, 0] <= step if by_step else spots[:, 0] == step
        # The opacity is that of equal dots upon each other.
        dots: dict[str, Any] = {"s": (3.2 * size) ** 2 * areas[now], "alpha": 1.0 - 0.65 ** counts[now]}
        dots |= {"color": colour, "linewidths": 0, "zorder": 3, "clip_on": not by_step}
        drawn.append(axes.scatter(*spots[now, -2:].T, **dots))
        drawn += axes.plot(*path.T, color=colour, linewidth=1.1 * size, alpha=0.6, zorder=4)
        rim = {"marker": "o", "markeredgecolor": "white", "markeredgewidth": 1.0 * size, "color": colour}
        drawn += axes.plot(*path[-1:].T, **rim, markersize=8.0 * size, zorder=5, clip_on=not by_step)
    return drawn


def _spots(rows: Floats, widest: float) -> tuple[Floats, NDArray[np.int64], Floats]:
    """The different states of the belief, each after its step; how often each occurs; areas of their dots.

    An area is in proportion to the count, and 1 for a single state, or less if dots would be too wide. The
    areas of a quantity that is never in doubt are all 1.
    """
    steps = np.repeat(np.arange(len(rows)), rows.shape[1] - 1)
    states = np.column_stack([steps, rows[:, 1:].reshape(len(steps), -1)])
    spots, counts = np.unique(states, axis=0, return_counts=True)
    areas = counts.astype(np.float64) if len(spots) > len(rows) else np.ones(len(rows))
    return spots.astype(np.float64), counts, areas * min(1.0, widest**2 / float(areas.max()))


def legend_of(all_sketches: Sequence[Sketch]) -> list[tuple[Line2D, str]]:
    """Handle and text of every name, in its colour."""
    entries: dict[str, Line2D] = {}
    for sketch in all_sketches:
        for name, colour in zip(sketch, cycle(_COLOURS), strict=False):
            dot = Line2D([], [], marker="o", linestyle="", color=colour, markersize=6)
            entries.setdefault(drawn_text(name), dot)
    return [(handle, name) for name, handle in entries.items()]
