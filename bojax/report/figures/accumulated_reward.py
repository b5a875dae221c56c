"""Mean accumulated reward by step: Fig. 4.6 of the thesis, with bands."""

import numpy as np

from bojax.report.drawing.base import Drawing, FigureUnavailable, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Results
from bojax.report.text import counted

RANK = 10


def draw(results: Results) -> Drawing:
    """Every planner's mean accumulated reward, from 0 at step 0; a run that has ended keeps its value."""
    if any(point.is_learning for point in results.points):
        raise FigureUnavailable("a run of a learner has many episodes: learning-curves shows them")
    points, note = drawn_points(results)
    curves, left_out = [], 0
    for point in points:
        values = results.by_step(point, "accumulated_reward")
        is_finite = np.isfinite(values[:, : (point.time_limit or results.num_steps) + 1]).all(axis=1)
        left_out += int((~is_finite).sum())
        curves.append(Curve.numbered(point, values[is_finite], first=0))
    details = "A run that has ended keeps its last value."
    if left_out:
        details += f" Left out: {counted(left_out, 'run')} with a non-finite value."
    panel = Panel("accumulated reward", "mean accumulated reward", curves)
    return Chart([panel], "step").drawing("Accumulated reward", details, note)
