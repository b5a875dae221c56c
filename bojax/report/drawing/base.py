"""What a figure is to the report: a function of the results that returns a drawing or says why it cannot."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from bojax.report.source import Point, Results

MAX_POINTS = 12
"""More curves or panels than this cannot be read: then the best point of each label is drawn."""


class Undrawable(Exception):
    """Why a figure cannot be drawn from these results."""


@dataclass(frozen=True)
class Drawing:
    """A figure with what stands around it on the page.

    Attributes:
        figure: The figure.
        title: Its heading.
        caption: What is drawn, and how it was computed.
        alt: What the figure shows, in words, for who cannot see it.
    """

    figure: Figure
    title: str
    caption: str
    alt: str


def drawn_points(results: Results, most: int = MAX_POINTS) -> tuple[tuple[Point, ...], str]:
    """The points that a figure shows, and a sentence for its caption where some are left out."""
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


def panel_grid(count: int) -> tuple[int, int]:
    """Rows and columns of a grid of square panels: two columns stay readable on a phone."""
    columns = min(count, 2)
    return -(-count // columns), columns
