"""Means over a swept number: one curve for each setting of everything else."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from bojax.report import growth, statistics, style
from bojax.report.drawing.base import Undrawable
from bojax.report.source import Point, Results
from bojax.report.text import counted, joined, number


@dataclass(frozen=True)
class Curve:
    """Means of one setting at each of the swept numbers.

    Attributes:
        point: A point of the setting, which gives it name and colour.
        x: `[n]` the numbers, from the least on.
        values: `[runs, n]` one value a run; NaN where a run has none.
    """

    point: Point
    x: statistics.Floats
    values: statistics.Floats

    @property
    def is_partial(self) -> np.ndarray:
        """Where some runs have no value."""
        return np.isnan(self.values.sum(axis=0))

    @property
    def law(self) -> growth.Fit | None:
        """The nearest law of growth, where there are means enough to tell."""
        if len(self.x) < 4 or (np.isfinite(self.values).sum(axis=0) < 2).any():
            return None
        means, errors = np.nanmean(self.values, axis=0), growth.errors_of(self.values)
        if not (means > 0).all():
            return None
        return min((growth.fit(law, self.x, means, errors) for law in growth.LAWS), key=lambda f: f.misfit)


def curves_over(results: Results, over: str, column: str) -> list[Curve]:
    """One curve for each setting of everything else that was swept."""
    groups: dict[tuple[str, str], list[Point]] = {}
    for point in results.points:
        if isinstance(point.swept.get(over), int | float) and results.runs_of(point)["run"].size:
            others = {key: value for key, value in point.swept.items() if key != over}
            groups.setdefault((point.variant, str(others)), []).append(point)
    curves = []
    for (variant, _), points in groups.items():
        points = sorted(points, key=lambda point: point.swept[over])
        values = results.paired(points, column).astype(np.float64)
        twins = [other for other, _ in groups if other == variant]
        name = variant if len(twins) == 1 else _without(points[0], over)
        x = np.array([float(point.swept[over]) for point in points])
        if len(points) > 1 and len(values) > 1:
            curves.append(Curve(replace(points[0], name=name), x, values))
    return curves


def read_curves(results: Results) -> tuple[str, str, list[Curve]]:
    """The swept number, the column and the curves that `report` asks for."""
    keys = dict.fromkeys(key for point in results.points for key in point.swept)
    numeric = [
        key
        for key in keys
        if len({value for point in results.points if isinstance(value := point.swept.get(key), int | float)})
        > 1
    ]
    over = results.report.over or (numeric[0] if len(numeric) == 1 else None)
    if over not in numeric:
        raise Undrawable(
            "the sweep has no number to draw over"
            if not numeric
            else f"report.over has to say which of {joined(numeric)} to draw over"
        )
    columns = [results.report.column, "steps_to_goal", "return"]
    column = next((name for name in columns if name in results.runs), None)
    if column is None or columns[0] not in (None, column):
        raise Undrawable(f"runs.parquet has no {columns[0] or 'return'}")
    curves = curves_over(results, over, column)
    if not curves:
        raise Undrawable(f"no setting was run with several values of {over}")
    return over, column, curves


def add_swept(axes: Axes, curves: Sequence[Curve]) -> None:
    """Draw the curves with their bands into a panel."""
    for curve, look in zip(curves, curve_looks(curves), strict=True):
        mean, low, high = statistics.mean_band(curve.values)
        axes.fill_between(curve.x, low, high, color=look["color"], alpha=0.16, linewidth=0)
        axes.plot(curve.x, mean, label=curve.point.name, **look)
        for is_hollow in (False, True):
            chosen = curve.is_partial == is_hollow
            axes.scatter(
                curve.x[chosen],
                mean[chosen],
                s=16,
                facecolors="white" if is_hollow else look["color"],
                edgecolors=look["color"],
                zorder=3,
            )
    numbers = np.unique(np.concatenate([curve.x for curve in curves]))
    if len(numbers) <= 10 and np.ptp(numbers) <= 20 * np.diff(numbers).min():
        axes.set_xticks(numbers, [f"{value:g}" for value in numbers])
    else:
        axes.xaxis.set_major_locator(MaxNLocator(nbins=8))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.10g}".replace("-", "\N{MINUS SIGN}"))
    style.quiet_grid(axes)


def add_legend(figure: Any, axes: Axes, curves: Sequence[Curve]) -> None:
    """Names of the curves, below the figure."""
    handles, names = axes.get_legend_handles_labels()
    wide = max(map(len, names)) > 24
    figure.legend(handles, names, loc="outside lower center", ncols=1 if wide else min(3, len(names)))


def curve_looks(curves: Sequence[Curve]) -> list[dict[str, Any]]:
    """Colour and line style of each curve."""
    return style.looks([curve.point for curve in curves])


def caption_of(column: str, over: str, curves: Sequence[Curve]) -> str:
    """What is drawn, and how it was computed."""
    runs = sorted({len(curve.values) for curve in curves})
    told = (
        f"Mean {heading(column)} over {heading(over)} of {counted(runs[-1], 'run')} each, with pointwise "
        "95% bootstrap bands."
    )
    if any(curve.is_partial.any() for curve in curves):
        told += " Hollow: some runs never got there, and are left out."
    return told


def ends_of(curves: Sequence[Curve]) -> str:
    """First and last mean of each curve, for the alternative text."""
    told = [
        f"{curve.point.name} {number(float(np.nanmean(curve.values[:, 0])))} at {curve.x[0]:g} and "
        f"{number(float(np.nanmean(curve.values[:, -1])))} at {curve.x[-1]:g}"
        for curve in curves
        if np.isfinite(curve.values[:, [0, -1]]).any(axis=0).all()
    ]
    return "; ".join(told)


def _without(point: Point, over: str) -> str:
    others = [
        f"{key.rsplit('.', 1)[-1]} {value}"
        for key, value in point.swept.items()
        if key != over and value not in point.variant.split("/")
    ]
    return ", ".join([point.variant, *others])


def heading(name: str) -> str:
    """A column or a key in words."""
    return name.rsplit(".", 1)[-1].replace("_", " ")
