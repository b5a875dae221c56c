"""A mean over a swept number, and how it grows with it: Figs. 5.6b and 5.6c of the thesis."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from bojax.report import growth, statistics, style
from bojax.report.figures.base import Drawing, Undrawable
from bojax.report.source import Point, Results
from bojax.report.text import counted, joined, number

_FITTED: dict[str, Any] = {"linewidth": 1.1, "linestyle": (0, (2, 2)), "zorder": 1.8}


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


def draw(results: Results) -> Drawing:
    """The mean of `report.column` over the swept number `report.over`, one curve per setting."""
    over, column, curves = _read(results)
    figure, grid = style.figure(3.6)
    _draw(grid[0, 0], curves)
    grid[0, 0].set_xlabel(_heading(over))
    grid[0, 0].set_ylabel(f"mean {_heading(column)}")
    _name(figure, grid[0, 0], curves)
    return Drawing(
        figure=figure,
        title=f"{_heading(column)} over {_heading(over)}".capitalize(),
        caption=_caption(column, over, curves),
        alt=f"Line chart of the mean {_heading(column)} over {_heading(over)}. {_ends(curves)}.",
    )


def draw_growth(results: Results) -> Drawing:
    """The same with the nearest law of growth; below on axes on which a power is a straight line."""
    over, column, curves = _read(results)
    laws = [curve.law for curve in curves]
    if not any(laws):
        raise Undrawable("a law of growth needs positive means at four values at least")
    figure, grid = style.figure(5.6, 2)
    for axes in grid[:, 0]:
        _draw(axes, curves)
        for curve, law, look in zip(curves, laws, _looks(curves), strict=True):
            if law is not None:
                x = np.linspace(curve.x[0], curve.x[-1], 200)
                fitted = np.where(law(x) > 0, law(x), np.nan)
                axes.plot(x, fitted, **{**look, **_FITTED, "color": style.INK})
        axes.set_ylabel(f"mean {_heading(column)}")
    grid[0, 0].set_ylim(bottom=0)
    lower = grid[1, 0]
    lower.set_xscale("log")
    lower.set_yscale("log")
    numbers = curves[0].x
    ticks = (
        numbers if len(numbers) <= 8 else numbers[np.unique(np.geomspace(1, len(numbers), 6).astype(int)) - 1]
    )
    lower.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    lower.minorticks_off()
    lower.yaxis.set_major_formatter(lambda value, _: f"{value:,.10g}")
    style.quiet_grid(lower, "both")
    lower.set_xlabel(f"{_heading(over)} (above: even scale, below: logarithmic)")
    _name(figure, grid[0, 0], curves)
    told = [
        f"{curve.point.name} {law.law}, {law}"
        for curve, law in zip(curves, laws, strict=True)
        if law is not None
    ]
    return Drawing(
        figure=figure,
        title=f"Growth of {_heading(column)}",
        caption=f"{_caption(column, over, curves)} Dotted: the nearest law of growth, of linear, quadratic "
        f"and exponential ones: {'; '.join(told)}. On the lower axes a power is a straight line, as steep as "
        "its exponent, and an exponential bends upwards.",
        alt=f"Line charts of the mean {_heading(column)} over {_heading(over)}, on even and on logarithmic "
        f"axes. {_ends(curves)}. Nearest laws: {'; '.join(told)}.",
    )


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


def _read(results: Results) -> tuple[str, str, list[Curve]]:
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


def _draw(axes: Axes, curves: Sequence[Curve]) -> None:
    for curve, look in zip(curves, _looks(curves), strict=True):
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


def _name(figure: Any, axes: Axes, curves: Sequence[Curve]) -> None:
    handles, names = axes.get_legend_handles_labels()
    wide = max(map(len, names)) > 24
    figure.legend(handles, names, loc="outside lower center", ncols=1 if wide else min(3, len(names)))


def _looks(curves: Sequence[Curve]) -> list[dict[str, Any]]:
    return style.looks([curve.point for curve in curves])


def _caption(column: str, over: str, curves: Sequence[Curve]) -> str:
    runs = sorted({len(curve.values) for curve in curves})
    told = (
        f"Mean {_heading(column)} over {_heading(over)} of {counted(runs[-1], 'run')} each, with pointwise "
        "95% bootstrap bands."
    )
    if any(curve.is_partial.any() for curve in curves):
        told += " Hollow: some runs never got there, and are left out."
    return told


def _ends(curves: Sequence[Curve]) -> str:
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


def _heading(name: str) -> str:
    return name.rsplit(".", 1)[-1].replace("_", " ")
