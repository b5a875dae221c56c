"""Mean accumulated reward by step: Fig. 4.6 of the thesis, with bands."""

import numpy as np

from bojax.report import statistics
from bojax.report.drawing.base import Drawing, Undrawable, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Results
from bojax.report.text import counted

RANK = 10


def draw(results: Results) -> Drawing:
    """Every planner's mean accumulated reward, from 0 at step 0; a run that has ended keeps its value."""
    steps, last = results.steps, results.num_steps
    if "accumulated_reward" not in steps or not last:
        raise Undrawable("steps.parquet has no accumulated_reward")
    if any(point.is_learning for point in results.points):
        raise Undrawable("a run of a learner has many episodes: learning-curves shows them")
    points, note = drawn_points(results)
    curves, left_out = [], 0
    for point in points:
        rows, runs = results.steps_of(point), results.runs_of(point)["run"]
        values = statistics.carry_forward(runs, rows["run"], rows["step"], rows["accumulated_reward"], last)
        is_finite = np.isfinite(values).all(axis=1)
        left_out += int((~is_finite).sum())
        curves.append(Curve(point, np.arange(last + 1.0), values[is_finite]))
    details = "A run that has ended keeps its last value."
    if left_out:
        details += f" Left out: {counted(left_out, 'run')} with a non-finite value."
    panel = Panel("accumulated reward", "mean accumulated reward", curves)
    return Chart([panel], "step").drawing("Accumulated reward", details, note)
