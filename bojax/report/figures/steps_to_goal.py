"""Steps of the episodes that reach the goal, by episode: Fig. 5.7d of the thesis."""

import numpy as np

from bojax.report.budgets import KEPT
from bojax.report.drawing.base import Drawing, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Results

RANK = 60


def draw(results: Results) -> Drawing:
    """Mean length of the successful training episodes; below, the share of runs whose episode succeeds."""
    points, note = drawn_points(results)
    lengths, successes = [], []
    for point in points:
        success, length = (results.by_episode(point, column) for column in ("success", "length"))
        limits = 1, getattr(point.env, "max_steps", None) or np.inf
        lengths.append(Curve.numbered(point, np.where(success > 0, length, np.nan), first=1, limits=limits))
        successes.append(Curve.numbered(point, success, first=1))
    quantity = "mean steps of the training episodes that reach the goal"
    panels = [
        Panel("steps to the goal", quantity, lengths),
        Panel("episodes at the goal (%)", "share of runs whose episode reaches it", successes, is_share=True),
    ]
    chart = Chart(panels, "episode")
    chart.axes[0].set_ylim(bottom=0)
    details = KEPT if results.has_early_success else ""
    return chart.drawing("Steps to the goal", details, note)
