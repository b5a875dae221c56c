"""Mean errors of the belief about a field over the distance driven."""

import numpy as np

from bojax.report.drawing.base import Drawing, FigureUnavailable, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Point, Results

RANK = 115
MARKS = 40  # distances at which the curves have values

ERRORS = {"rmse": "RMSE", "mean_std": "mean standard deviation"}
"""Columns that are drawn, and their names."""


def draw(results: Results) -> Drawing:
    """The errors at equal distances; each run is constant between two steps, and ends with its last step."""
    points, note = drawn_points(results)
    if not all("distance" in results.steps and column in results.steps for column in ERRORS):
        raise FigureUnavailable("steps.parquet has no errors by distance: problem.errors_by_step is false")
    longest = max(float(np.max(results.steps_of(point)["distance"], initial=0.0)) for point in points)
    marks = np.linspace(0.0, longest, MARKS + 1)[1:]
    panels = [
        Panel(
            name,
            f"{name} averaged over runs",
            [Curve(point, marks, _at(results, point, column, marks), (0, np.inf)) for point in points],
        )
        for column, name in ERRORS.items()
    ]
    details = "Errors of the belief after the last step before each distance; a run has none beyond its end."
    return Chart(panels, "distance (m)").drawing("Errors by distance", details, note)


def _at(results: Results, point: Point, column: str, marks: np.ndarray) -> np.ndarray:
    """A column at distances, `[runs, marks]`; NaN before the first step and beyond the last."""
    rows, runs = results.steps_of(point), results.runs_of(point)["run"]
    values = np.full((runs.size, marks.size), np.nan)
    for index, run in enumerate(runs):
        own = rows["run"] == run
        distance = rows["distance"][own]
        if distance.size:
            last = np.searchsorted(distance, marks * (1.0 + 1e-9), side="right") - 1
            known = (last >= 0) & (marks <= distance[-1] * (1.0 + 1e-9))
            values[index, known] = rows[column][own][last[known]]
    return values
