"""Curves with bands over steps, episodes or swept numbers: figures extract the values, `Chart` draws them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any, TypeAlias

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from bojax.report import statistics, style
from bojax.report.drawing.base import Drawing, FigureUnavailable
from bojax.report.source import Point
from bojax.report.statistics import Band, Floats
from bojax.report.text import capitalised, joined, number, percent, ranged

Limits: TypeAlias = tuple[ArrayLike, ArrayLike]  # the least and the greatest value possible
ANY: Limits = -np.inf, np.inf

_MAX_DIRECT = 10
_MAX_LINES, _MAX_LINE = 2, 16
"""More names, or names with more lines or longer ones, are listed below the figure, not beside the curves."""

_ROW = 0.2  # height of a row of this list in inches


@dataclass(frozen=True, eq=False)
class Curve:
    """Values of the runs of one setting."""

    point: Point  # a point of the setting, which gives the curve its name and colour
    x: Floats  # `[n]` steps, episodes or swept numbers, in ascending order
    values: Floats  # `[runs, n]` one value per run; NaN where it is missing
    limits: Limits = ANY  # of their means

    @classmethod
    def numbered(cls, point: Point, values: Floats, first: int, limits: Limits = ANY) -> "Curve":
        """Values of consecutive steps or episodes from a first one on."""
        return cls(point, first + np.arange(float(values.shape[1])), values, limits)

    @property
    def is_partial(self) -> np.ndarray:
        """Where some of the runs have no value."""
        return np.isnan(self.values).sum(axis=0) > 0


@dataclass(frozen=True, eq=False)
class Panel:
    """The curves of one pair of axes."""

    label: str  # label of the vertical axis, with its unit
    quantity: str  # what the curves are, for captions: `mean return`
    curves: Sequence[Curve]  # one curve per setting
    is_share: bool = False  # whether values are 0 or 1: their mean is then a percentage
    missing: str = ""  # sentence for the caption of a panel where some runs lack values

    @cached_property
    def bands(self) -> list[Band]:
        """Mean, lower and upper bound of each curve, cut to its limits."""
        band = statistics.share_band if self.is_share else statistics.mean_band
        bands = []
        for curve in self.curves:
            mean, low, high = band(curve.values)
            low, high = np.maximum(low, curve.limits[0]), np.minimum(high, curve.limits[1])
            bands.append((mean, low, high))
            if self.is_share and curve.x[0] == 0:
                high[0] = 0.0  # no run can have succeeded before the first step: this is not an estimate
        return bands

    @property
    def method(self) -> str:
        """How the bands are computed, in words; empty if there are none."""
        if not any(np.isfinite(low).any() for _, low, _ in self.bands):
            return ""
        counts = (np.isfinite(curve.values).sum(axis=0) for curve in self.curves)
        return "Wilson" if self.is_share else statistics.methods(np.concatenate([*counts]).tolist())

    @property
    def drawn(self) -> list[tuple[Curve, Band, dict[str, Any]]]:
        """Every curve that has a value, with its band and its look."""
        looks = style.looks([curve.point for curve in self.curves])
        entries = zip(self.curves, self.bands, looks, strict=True)
        return [(curve, band, look) for curve, band, look in entries if np.isfinite(band[0]).any()]


class Chart:
    """A figure of panels of curves, one above the other, and the words that go with it."""

    figure: Figure  # the names of the curves are added by `drawing`
    axes: list[Axes]  # of each panel, from the top

    def __init__(self, panels: Sequence[Panel], xlabel: str, *, is_swept: bool = False) -> None:
        """Draw panels over `step`, `episode` or a swept number; a panel may be drawn twice."""
        if not panels[0].drawn:
            raise FigureUnavailable(f"no run has a finite value: {panels[0].quantity}")
        self._panels, self._xlabel = panels, xlabel
        self._named = max(panels, key=lambda panel: len(panel.drawn))
        self._points = [curve.point for curve, _, _ in self._named.drawn]
        self._names = style.drawn_names(self._points)
        self._parts = count()
        self._beside = [style.wrapped(name, _MAX_LINE) for name in self._names]
        lines = [name.split("\n") for name in self._beside]
        is_long = any(len(each) > _MAX_LINES or max(map(len, each)) > _MAX_LINE for each in lines)
        is_listed = is_long or len(self._names) > _MAX_DIRECT
        # Of the list of names below the figure; no rows if the names stand beside the curves
        self._columns_below = 1 if max(map(len, self._names)) > 24 else 2
        self._rows_below = math.ceil(len(self._names) / self._columns_below) if is_listed else 0
        height = (3.6 if len(panels) == 1 else 0.5 + 2.4 * len(panels)) + _ROW * self._rows_below
        if not self._rows_below:
            names = len(self._names) * max(name.count("\n") + 1 for name in self._beside)
            height = max(height, len(panels) * (0.3 + style.LINE_POINTS * names / (0.8 * 72)))
        self.figure, grid = style.figure(height, len(panels), sharex=not is_swept)
        self.axes = list(grid[:, 0])
        self._lines: dict[Axes, list[Line2D]] = {axes: [] for axes in self.axes}
        for axes, panel in zip(self.axes, panels, strict=True):
            self._draw_curves(axes, panel, is_swept=is_swept)
            _set_axes(axes, panel, is_swept=is_swept)
        self.axes[-1].set_xlabel(style.drawn_text(xlabel))

    def mark(self, curve: Curve, *artists: Artist) -> None:
        """Make artists part of a curve, so that a reader of the page hides them with it.

        In the SVG, their ids begin with `curve-N-`, those of the curve's name with `name-N-`.
        """
        number = next((i for i, point in enumerate(self._points) if point is curve.point), None)
        if number is not None:
            for artist in artists:
                artist.set_gid(f"curve-{number}-{next(self._parts)}")

    def add_levels(self, levels: Mapping[str, float]) -> None:
        """Draw a horizontal line at each value of the first panel, named at its right end."""
        axes, above = self.axes[0], np.inf
        for value in levels.values():
            axes.axhline(value, color=style.FAINT, linewidth=1.0, linestyle=(0, (4, 3)), zorder=0.8)
        low, high = axes.get_ylim()
        for name, value in sorted(levels.items(), key=lambda level: -level[1]):
            # A name that would cover the one above it is written below its line.
            place = "top" if above - value < 0.06 * (high - low) else "bottom"
            look: dict[str, Any] = {"ha": "right", "va": place, "size": "small", "color": style.INK}
            axes.text(0.99, value, style.drawn_text(name), transform=axes.get_yaxis_transform(), **look)
            above = value

    def drawing(self, title: str, details: str = "", note: str = "") -> Drawing:
        """The figure with the names of its curves, its caption and its alternative text.

        `details` are the sentences of the caption that belong to this figure alone; `note` is that of
        `drawn_points`.
        """
        self._add_names()
        panels = list(dict.fromkeys(self._panels))
        drawn = [curve for panel in panels for curve, _, _ in panel.drawn]
        runs = ranged((len(curve.values) for curve in drawn), "run")
        caption = []
        for panel, row in zip(panels, ("Above: ", "Below: "), strict=False):
            text = panel.quantity if len(panels) > 1 else capitalised(panel.quantity)
            bands = f", with pointwise 95% bands ({panel.method})" if panel.method else ""
            caption.append(f"{row * (len(panels) > 1)}{text}{bands}.")
        partial = [panel.missing for panel in panels if any(c.is_partial.any() for c, _, _ in panel.drawn)]
        absent = [curve.point.name for curve in self._named.curves if curve not in drawn]
        caption += [
            f"By {self._xlabel}, {runs} per curve.",
            details,
            *partial,
            f"Without a value: {joined(absent)}." if absent else "",
        ]
        return Drawing(
            figure=self.figure,
            title=title,
            caption=" ".join(filter(None, caption)) + note,
            alt=" ".join(map(self._described, panels)),
            curves=[point.name for point in self._points] if len(self._points) > 1 else (),
        )

    def _described(self, panel: Panel) -> str:
        write = percent if panel.is_share else number
        ends = []
        for curve, (mean, _, _), _ in panel.drawn:
            first, last = mean[np.isfinite(mean)][[0, -1]].tolist()
            ends.append(f"{curve.point.name} {write(first)} and {write(last)}")
        return (
            f"Line chart of the {panel.quantity}, by {self._xlabel}. "
            f"First and last value of each curve: {'; '.join(ends)}."
        )

    def _add_names(self) -> None:
        """Names beside the right ends of the curves, or below the figure where they are many or long."""
        axes, entries = self.axes[self._panels.index(self._named)], self._named.drawn
        if self._rows_below:
            lines, columns = self._lines[axes], self._columns_below
            legend = style.legend(self.figure, lines, self._names, loc="outside lower center", ncols=columns)
            for number, entry in enumerate(zip(legend.legend_handles, legend.get_texts(), strict=True)):
                for kind, artist in zip(("line", "text"), entry, strict=True):
                    if artist is not None:
                        artist.set_gid(f"name-{number}-{kind}")
            return
        ends = [float(mean[np.isfinite(mean)][-1]) for _, (mean, _, _), _ in entries]
        last = max(float(curve.x[-1]) for curve, _, _ in entries)
        style.direct_labels(axes, last, ends, self._beside, [look["color"] for _, _, look in entries])

    def _draw_curves(self, axes: Axes, panel: Panel, *, is_swept: bool) -> None:
        opacity = min(0.16, 0.5 / len(panel.drawn))  # many bands on top of each other would hide the curves
        for curve, (mean, low, high), look in panel.drawn:
            band = axes.fill_between(curve.x, low, high, color=look["color"], alpha=opacity, linewidth=0)
            dots: dict[str, Any] = {}
            if not is_swept and (unseen := without_line(mean)).any():
                dots = {"marker": look["marker"] or "o", "markersize": 3, "markevery": unseen}
            lines = axes.plot(curve.x, mean, **{**look, **dots})
            self._lines[axes] += lines
            self.mark(curve, band, *lines)
            if is_swept:
                faces = np.where(curve.is_partial, "white", look["color"])
                edges = {"facecolors": faces, "edgecolors": look["color"]}
                marker = look["marker"] or "o"
                self.mark(curve, axes.scatter(curve.x, mean, s=16, marker=marker, zorder=3, **edges))


def without_line(values: Floats) -> np.ndarray:
    """Which values need a dot: all of one or two, and those between gaps, which no line reaches."""
    is_there = np.isfinite(values)
    if len(values) < 3:
        return is_there
    before, after = np.append(False, is_there[:-1]), np.append(is_there[1:], False)
    return is_there & ~before & ~after


def step_ticks(last: int) -> list[int]:
    """At most nine evenly spaced whole steps from 0, the last one among them where the spacing allows it."""
    spacings = [factor * 10**power for power in range(len(str(last))) for factor in (1, 2, 3, 5)]
    few = [spacing for spacing in spacings if last // spacing < 9]
    spacing = next((spacing for spacing in few[:3] if last % spacing == 0), few[0])
    return list(range(0, last + 1, spacing))


def _set_axes(axes: Axes, panel: Panel, *, is_swept: bool) -> None:
    numbers = np.unique(np.concatenate([curve.x for curve in panel.curves]))
    if is_swept and len(numbers) <= 10 and np.ptp(numbers) <= 20 * np.diff(numbers).min():
        axes.set_xticks(numbers, [f"{value:g}" for value in numbers])
    elif is_swept:  # too many numbers, or too close for their labels
        axes.xaxis.set_major_locator(MaxNLocator(nbins=8))
    else:
        first, last = int(numbers[0]), int(numbers[-1])
        axes.set_xlim(min(first, last - 1), max(last, 1))
        axes.set_xticks([tick for tick in step_ticks(last) if tick >= first])
    if panel.is_share:
        axes.set_ylim(0, 1)
        axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "25", "50", "75", "100"])
    else:
        if not is_swept:
            axes.axhline(0, color="#9A9A9A", linewidth=0.8, zorder=0.5)
        style.plain_ticks(axes.yaxis)
    axes.set_ylabel(style.drawn_text(panel.label))
    style.quiet_grid(axes)
