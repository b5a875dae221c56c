"""Drawings, which figures make from results, and the points that they show."""

import base64
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bojax.report import style
from bojax.report.source import Point, Results
from bojax.report.statistics import Interval

T = TypeVar("T")

MAX_POINTS = 12
"""Largest number of readable curves or panels; of more points, the best one of each label is drawn."""


class FigureUnavailable(Exception):
    """The results do not allow a figure; the message says why."""


@dataclass(frozen=True)
class Drawing:
    """A figure with its title and texts, and its files."""

    figure: Figure
    title: str
    caption: str  # content of the figure, and how it was computed
    alt: str  # alternative text for screen readers
    curves: Sequence[str] = ()  # names of the curves that a reader of the page can hide, see `Chart.mark`

    @cached_property
    def files(self) -> Mapping[str, bytes]:
        """`png` and `svg`, see `encoded`."""
        return style.encode(self.figure)

    def encoded(self) -> "Drawing":
        """Make the files now, while `style.settings` is in force, and return the drawing."""
        _ = self.files
        return self

    @property
    def source(self) -> str:
        """The SVG as a data URL, so that a page loads no other file."""
        code = base64.b64encode(style.adapted(self.files["svg"])).decode("ascii")
        return f"data:image/svg+xml;base64,{code}"


def drawn_points(results: Results, most: int = MAX_POINTS) -> tuple[tuple[Point, ...], str]:
    """The points that a figure shows, and a sentence for its caption if some are left out."""
    points = tuple(results.run_points)
    if not points:
        raise FigureUnavailable("no point has a run")
    if len(points) <= most:
        return points, ""

    def score(point: Point) -> float:
        mean = float(np.mean(results.runs_of(point).get(results.return_column, np.zeros(1))))
        return mean if np.isfinite(mean) else -np.inf

    labels = dict.fromkeys(point.label for point in points)
    best = [max((point for point in points if point.label == label), key=score) for label in labels]
    note = f" Of {len(points)} points, the one with the best mean return of each label is drawn."
    return tuple(best[:most]), note


def points_with(
    results: Results, recorded: Callable[[Point], dict[int, T]], missing: str, most: int = MAX_POINTS
) -> tuple[list[tuple[Point, dict[int, T]]], str]:
    """The drawn points with what was recorded of them, by run, and the note of `drawn_points`."""
    points, note = drawn_points(results, most)
    if found := [(point, kept) for point in points if (kept := recorded(point))]:
        return found, note
    raise FigureUnavailable(missing)


def panel_grid(
    count: int, height: Callable[[int], float], spare: float, **options: Any
) -> tuple[Figure, np.ndarray]:
    """A figure with a grid of `count` panels, in at most two columns so that a phone can show it.

    The height of a panel is a function of the number of columns; the figure is higher than its panels by
    `spare`, in inches. The options are those of `style.figure`.
    """
    columns = min(count, 2)
    rows = -(-count // columns)
    figure, grid = style.figure(rows * height(columns) + spare, rows, columns, **options)
    for axes in grid.flat[count:]:
        axes.set_visible(False)
    return figure, grid


def name_panels(panels: Iterable[Axes], points: Sequence[Point], pad: float = 4) -> None:
    """Write the name of each point, in its colour, above its panel."""
    for axes, name, look in zip(panels, style.drawn_names(points), style.looks(points), strict=False):
        axes.set_title(style.wrapped(name, 24), color=look["color"], pad=pad)


def label_panels(grid: np.ndarray, x: str | None, y: str | None, **options: Any) -> None:
    """Write the labels that a grid of panels shares, below its last row and beside its first column."""
    if x is not None:
        for axes in grid[-1]:
            axes.set_xlabel(style.drawn_text(x), **options)
    if y is not None:
        for axes in grid[:, 0]:
            axes.set_ylabel(style.wrapped(y, 30), **options)


NAME_WIDTH = 16  # characters in a line of a name beside the panels of `dot_plot`


def dot_plot(
    points: Sequence[Point], rows: int, columns: int, *, ticks: int, spare: float = 0.75, least: float = 0.24
) -> tuple[Figure, np.ndarray]:
    """A figure of panels with a row for each point, whose names are beside the first column.

    A row is at least `least` inches high, and a panel has `spare` inches for its title and axis.
    """
    lines = max(style.wrapped(name, NAME_WIDTH).count("\n") + 1 for name in style.drawn_names(points))
    height = spare + max(least, 0.06 + 0.17 * lines) * len(points)
    figure, grid = style.figure(rows * height + 0.15 * (rows > 1), rows, columns)
    figure.set_layout_engine("constrained", wspace=0.1)
    for panels in grid:
        for place, axes in enumerate(panels):
            set_rows(axes, points, bottom=0.5, ticks=ticks, name_width=0 if place else NAME_WIDTH)
    return figure, grid


def set_rows(axes: Axes, points: Sequence[Point], *, bottom: float, ticks: int, name_width: int = 0) -> None:
    """Set the limits and ticks of a panel with one row per point, the first at the top.

    The space below the last row is `bottom` rows high, and the horizontal axis has at most `ticks` intervals.
    Lines of names have at most `name_width` characters; 0 leaves the names out.
    """
    names = [style.wrapped(name, name_width) for name in style.drawn_names(points)] if name_width else []
    axes.set_yticks(range(len(names)), names)
    for tick, look in zip(axes.get_yticklabels(), style.looks(points), strict=False):
        tick.set_color(look["color"])
    axes.set_ylim(len(points) - 1 + bottom, -0.5)
    axes.spines["left"].set_visible(False)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=ticks))
    style.plain_ticks(axes.xaxis)
    style.quiet_grid(axes, "x")
    axes.tick_params(axis="y", length=0)


def draw_intervals(axes: Axes, points: Sequence[Point], intervals: Sequence[Interval]) -> None:
    """Draw a dot with its interval in the row of each point, see `set_rows`."""
    for row, (look, interval) in enumerate(zip(style.looks(points), intervals, strict=True)):
        axes.plot([interval.low, interval.high], [row, row], color=look["color"], linewidth=2)
        axes.scatter([interval.estimate], [row], s=24, color=look["color"], zorder=3)
