"""Mean accumulated reward by step: Fig. 4.6 of the thesis, with the bands that it leaves out."""

import numpy as np

from bojax.report import statistics
from bojax.report.drawing.base import Drawing, Undrawable, drawn_points
from bojax.report.drawing.curves import draw_curves
from bojax.report.source import Results
from bojax.report.text import counted, number

RANK = 10


def draw(results: Results) -> Drawing:
    """Every planner's mean accumulated reward, from 0 at step 0; a run that has ended keeps its value."""
    steps = results.steps
    if "accumulated_reward" not in steps or not results.num_steps:
        raise Undrawable("steps.parquet has no accumulated_reward")
    if any(point.is_learning for point in results.points):
        raise Undrawable("a run of a learner has many episodes: learning-curves shows them")
    points, note = drawn_points(results)
    curves, left_out, most = {}, 0, 0
    for point in points:
        rows, runs = results.steps_of(point), results.runs_of(point)["run"]
        values = statistics.carry_forward(
            runs, rows["run"], rows["step"], rows["accumulated_reward"], results.num_steps
        )
        finite = np.isfinite(values).all(axis=1)
        left_out += int((~finite).sum())
        most = max(most, int(finite.sum()))
        if finite.any():
            curves[point.index] = statistics.mean_band(values[finite])
    points = tuple(point for point in points if point.index in curves)
    if not points:
        raise Undrawable("no run has a finite accumulated reward")
    caption = (
        f"Mean accumulated reward by step of {counted(most, 'run')} each, with pointwise 95% bootstrap "
        f"bands. A run that has ended keeps its last value.{note}"
    )
    if left_out:
        caption += f" {counted(left_out, 'run')} with a value that is not a number left out."
    ends = ", ".join(f"{point.name} {number(float(curves[point.index][0][-1]))}" for point in points)
    return Drawing(
        figure=draw_curves(points, curves, "accumulated reward"),
        title="Accumulated reward",
        caption=caption,
        alt=f"Line chart of the mean accumulated reward over {counted(results.num_steps, 'step')}. "
        f"At the last step: {ends}.",
    )
