"""A mean over a swept number, one curve per setting of everything else, and its nearest law of growth."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bojax.report import style
from bojax.report.budgets import limit_of, times_within
from bojax.report.columns import Columns
from bojax.report.drawing.base import MAX_POINTS, Drawing, FigureUnavailable
from bojax.report.drawing.curves import ANY, Chart, Curve, Limits, Panel
from bojax.report.growth import LAWS, Fit, errors_of, fit
from bojax.report.ranking import ENDS, Measure, signed
from bojax.report.source import Point, Results, distinct_names, swept_keys, swept_values
from bojax.report.text import capitalised, heading, is_number, joined, number

WIDE = 20
"""Ratio of the greatest to the least swept number from which the axis is logarithmic."""

_FITTED: dict[str, Any] = {"color": style.INK, "linewidth": 1.1, "linestyle": (0, (2, 2)), "zorder": 1.8}


def sweep_curve(results: Results) -> Drawing:
    """The mean of `report.column` over the swept number `report.over`."""
    panel, over, column, note = swept_panel(results, to_the_end=True)
    chart = Chart([panel], over, is_swept=True)
    x = np.concatenate([curve.x for curve in panel.curves])
    if 0 < WIDE * x.min() <= x.max():
        axes, ticks = chart.axes[0], np.unique(x)
        axes.set_xscale("log")
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    lines = results.report.lines
    chart.add_levels(lines)
    named = [f"{name} ({number(value)})" for name, value in lines.items()]
    details = f"Dashed: {joined(named)}." if named else ""
    return chart.drawing(capitalised(f"{column} over {over}"), details, note)


def swept_panel(results: Results, *, to_the_end: bool = False) -> tuple[Panel, str, str, str]:
    """The panel of `report.column` over `report.over`, and the names of both in words.

    Last comes a sentence for the caption if some curves are left out. Without these settings, the panel is of
    the steps to the goal, or the return, over the only swept number. A run without the goal may count with
    the end of the longest run, see `ENDS`.
    """
    over = _swept_number(results)
    asked = results.report.column
    usual = results.return_column
    column = next((name for name in (asked or "steps_to_goal", usual) if name in results.runs), None)
    if column is None or asked not in (None, column):
        raise FigureUnavailable(f"runs.parquet has no {asked or usual}")
    curves = curves_over(results, over, column)
    if not curves:
        raise FigureUnavailable(f"no setting was run with several values of {over}")
    quantity, name = f"mean {heading(column)}", heading(column)
    if to_the_end and column in ENDS:
        measure, longest = Measure(column, is_least=True), float(results.runs[ENDS[column]].max())
        quantity, name = measure.label, f"{measure.words.removeprefix('mean ')},"
        curves = [_to_the_end(curve, longest) for curve in curves]
    missing = "Hollow markers: means over only those runs that have a value."
    curves, note = readable(curves, is_least=signed(column)[1])
    return Panel(quantity, quantity, curves, missing=missing), heading(over), name, note


def _to_the_end(curve: Curve, longest: float) -> Curve:
    """A curve of times to the goal, in which missing ones count with the end of the longest run."""
    most = longest if curve.is_partial.any() else np.inf
    return replace(curve, values=times_within(curve.values, longest), limits=(1, most))


def readable(curves: list[Curve], *, is_least: bool) -> tuple[list[Curve], str]:
    """The best curve of each label if there are too many to be read, and a sentence that says so."""
    if len(curves) <= MAX_POINTS:
        return curves, ""

    def score(curve: Curve) -> float:
        mean = float(np.mean(curve.values)) * (-1 if is_least else 1)
        return mean if np.isfinite(mean) else -np.inf

    labels = dict.fromkeys(curve.point.label for curve in curves)
    best = [max((curve for curve in curves if curve.point.label == label), key=score) for label in labels]
    extreme = "least" if is_least else "greatest"
    note = f" Of {len(curves)} settings, the one with the {extreme} mean of each label is drawn."
    return best[:MAX_POINTS], note


def curves_over(results: Results, over: str, column: str) -> list[Curve]:
    """One curve for each setting that was run with several values of a swept number."""
    groups: dict[tuple[str, str], list[Point]] = {}
    for point in results.run_points:
        if is_number(point.swept.get(over)):
            others = {key: value for key, value in point.swept.items() if key != over}
            groups.setdefault((point.variant, str(others)), []).append(point)
    settings = [replace(points[0], swept={**points[0].swept, over: None}) for points in groups.values()]
    curves = []
    for points, name in zip(groups.values(), distinct_names(settings), strict=True):
        points = sorted(points, key=lambda point: point.swept[over])
        values = results.paired(points, column).astype(np.float64)
        x = np.array([float(point.swept[over]) for point in points])
        if len(points) > 1 and len(values) > 1:
            limits = _limits([results.runs_of(point) for point in points], column)
            curves.append(Curve(replace(points[0], name=name), x, values, limits))
    return curves


def _limits(runs: Sequence[Columns], column: str) -> Limits:
    """The least and the greatest mean possible of a column in the runs of several points."""
    if (end := ENDS.get(column)) is not None:
        return 1, [limit_of(each[column], each[end], each[end]) for each in runs]
    return (0, 1) if runs[0][column].dtype.kind == "b" else ANY


def _swept_number(results: Results) -> str:
    points = results.points
    numeric = [key for key in swept_keys(points) if sum(map(is_number, swept_values(points, key))) > 1]
    over = results.report.over or (numeric[0] if len(numeric) == 1 else None)
    if over in numeric:
        return over
    if not numeric:
        raise FigureUnavailable("the sweep has no number to draw over")
    raise FigureUnavailable(f"report.over must name the number to draw over: one of {joined(numeric)}")


def growth(results: Results) -> Drawing:
    """The curves of `sweep-curve` with the nearest law of growth (Figs. 5.6b and 5.6c of the thesis)."""
    panel, over, column, note = swept_panel(results)
    laws = [(curve, law) for curve in panel.curves if (law := nearest_law(curve)) is not None]
    if not laws:
        raise FigureUnavailable("a law of growth needs positive means at four values or more")
    chart = Chart([panel, panel], over, is_swept=True)
    linear, logarithmic = chart.axes
    for curve, law in laws:
        x = np.linspace(curve.x[0], curve.x[-1], 200)
        for axes in chart.axes:
            chart.mark(curve, *axes.plot(x, np.where(law(x) > 0, law(x), np.nan), **_FITTED))
    linear.set_ylim(bottom=0)
    logarithmic.set_xscale("log")
    logarithmic.set_yscale("log")
    x = laws[0][0].x
    ticks = x if len(x) <= 8 else x[np.unique(np.geomspace(1, len(x), 6).astype(int)) - 1]
    logarithmic.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    logarithmic.minorticks_off()
    style.plain_ticks(logarithmic.yaxis)
    style.quiet_grid(logarithmic, "both")
    fits = "; ".join(f"{curve.point.name} {law.law}, {law}" for curve, law in laws)
    return chart.drawing(
        f"Growth of {column}",
        "Below: the same on logarithmic axes, where a power law is a straight line whose slope is its "
        "exponent, and an exponential bends upwards. Dotted: the nearest of the linear, quadratic and "
        f"exponential laws: {fits}.",
        note,
    )


def nearest_law(curve: Curve) -> Fit | None:
    """The law of growth nearest to the means; None where these are too few or not positive."""
    if len(curve.x) < 4 or (np.isfinite(curve.values).sum(axis=0) < 2).any():
        return None
    means, errors = np.nanmean(curve.values, axis=0), errors_of(curve.values)
    if not (means > 0).all():
        return None
    return min((fit(law, curve.x, means, errors) for law in LAWS), key=lambda found: found.misfit)
