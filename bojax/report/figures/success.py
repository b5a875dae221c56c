"""Share of runs that have succeeded by each step."""

import numpy as np

from bojax.report.budgets import within_budget
from bojax.report.drawing.base import Drawing, FigureUnavailable, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Results

RANK = 20


def draw(results: Results) -> Drawing:
    """Success by step, of runs that end at success: each succeeds at its last step or never."""
    points, note = drawn_points(results)
    if not all(point.has_success and point.ends_at_success for point in points):
        raise FigureUnavailable(
            "a run of this problem does not end at success, so its steps do not tell when it succeeded"
        )
    x = np.arange(max(results.num_steps, results.runs["steps"].max()) + 1.0)
    curves = []
    for point in points:
        rows = results.runs_of(point)
        when = np.where(rows["success"].astype(bool), rows["steps"], np.inf)
        share = (when[:, None] <= x).astype(np.float64)
        curves.append(Curve(point, x, within_budget(share, rows["steps"], results.final_runs(point))))
    panel = Panel("runs that have succeeded (%)", "share of runs that have succeeded", curves, is_share=True)
    return Chart([panel], "step").drawing("Success by step", note=note)
