"""Drawings, which figures make from results, and the points that they show."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bojax.report import style
from bojax.report.source import Point, Results

MAX_POINTS = 12
"""Largest number of readable curves or panels; of more points, the best one of each label is drawn."""


class Undrawable(Exception):
    """The results do not allow a figure; the message says why."""


@dataclass(frozen=True)
class Drawing:
    """A figure with its title and texts.

    Attributes:
        figure: The figure.
        title: Its heading.
        caption: Content of the figure, and how it was computed.
        alt: Alternative text for screen readers.
    """

    figure: Figure
    title: str
    caption: str
    alt: str


def drawn_points(results: Results, most: int = MAX_POINTS) -> tuple[tuple[Point, ...], str]:
    """The points that a figure shows, and a sentence for its caption if some are left out."""
    points = tuple(point for point in results.points if results.runs_of(point)["run"].size)
    if not points:
        raise Undrawable("no point has a run")
    if len(points) <= most:
        return points, ""
    best: dict[str, tuple[float, Point]] = {}
    for point in points:
        returns = results.runs_of(point).get("return", np.zeros(1))
        mean = float(np.mean(returns))
        score = mean if np.isfinite(mean) else -np.inf
        if point.label not in best or score > best[point.label][0]:
            best[point.label] = (score, point)
    kept = tuple(point for _, point in best.values())[:most]
    return kept, f" Of {len(points)} points, the one with the best mean return of each label is drawn."


def name_panels(panels: Iterable[Axes], points: Sequence[Point], pad: float = 4) -> None:
    """Write the name of each point, in its colour, above its panel; hide the panels that remain."""
    for axes, point, look in zip_longest(panels, points, style.looks(points)):
        if point is None:
            axes.set_visible(False)
        else:
            axes.set_title(style.wrapped(point.name, 24), color=look["color"], pad=pad)


def panel_grid(count: int) -> tuple[int, int]:
    """Numbers of rows and columns of a grid of square panels, readable on a phone."""
    columns = min(count, 2)
    return -(-count // columns), columns
