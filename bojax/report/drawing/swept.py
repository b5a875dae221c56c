"""Values over a swept number: one curve for each setting of everything else that was swept."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bojax.report.drawing.base import Undrawable
from bojax.report.drawing.curves import Curve, Panel
from bojax.report.source import Point, Results
from bojax.report.text import heading, joined


def swept_panel(results: Results) -> tuple[Panel, str, str]:
    """The panel of `report.column` over `report.over`, and the names of both in words.

    Without these settings, the panel is of the steps to the goal, or the return, over the only swept number.

    Raises:
        Undrawable: There is no such number or column.
    """
    over = _swept_number(results)
    asked = results.report.column
    column = next((name for name in (asked or "steps_to_goal", "return") if name in results.runs), None)
    if column is None or asked not in (None, column):
        raise Undrawable(f"runs.parquet has no {asked or 'return'}")
    curves = curves_over(results, over, column)
    if not curves:
        raise Undrawable(f"no setting was run with several values of {over}")
    quantity = f"mean {heading(column)}"
    missing = "Hollow markers: means over only those runs that have a value."
    return Panel(quantity, quantity, curves, missing=missing), heading(over), heading(column)


def curves_over(results: Results, over: str, column: str) -> list[Curve]:
    """One curve for each setting that was run with several values of a swept number."""
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
        name = variant if len(twins) == 1 else _name_without(points[0], over)
        x = np.array([float(point.swept[over]) for point in points])
        if len(points) > 1 and len(values) > 1:
            curves.append(Curve(replace(points[0], name=name), x, values))
    return curves


def _swept_number(results: Results) -> str:
    keys = dict.fromkeys(key for point in results.points for key in point.swept)
    numeric = [key for key in keys if len(_numbers(results.points, key)) > 1]
    over = results.report.over or (numeric[0] if len(numeric) == 1 else None)
    if over in numeric:
        return over
    if not numeric:
        raise Undrawable("the sweep has no number to draw over")
    raise Undrawable(f"report.over must name the number to draw over: one of {joined(numeric)}")


def _numbers(points: Sequence[Point], key: str) -> set[float]:
    return {value for point in points if isinstance(value := point.swept.get(key), int | float)}


def _name_without(point: Point, over: str) -> str:
    """The name of a setting: its variant, and the swept values other than the number drawn over."""
    others = [
        f"{key.rsplit('.', 1)[-1]} {value}"
        for key, value in point.swept.items()
        if key != over and value not in point.variant.split("/")
    ]
    return ", ".join([point.variant, *others])
