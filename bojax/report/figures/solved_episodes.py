"""Number of training episodes solved so far, by episode: Fig. 5.8b of the thesis, with bands."""

import numpy as np

from bojax.report.budgets import KEPT
from bojax.report.drawing.base import Drawing, FigureUnavailable, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Results

RANK = 50


def draw(results: Results) -> Drawing:
    """The mean over runs of the successes up to each episode; a run that success ended keeps its number."""
    points, note = drawn_points(results)
    curves = []
    for point in points:
        solved = results.by_episode(point, "success", is_summed=True)
        solved = np.pad(solved, ((0, 0), (1, 0)))  # nothing is solved before the first episode
        curves.append(Curve.numbered(point, solved, first=0, limits=(0, np.arange(solved.shape[1]))))
    if max(curve.values.max(initial=0.0) for curve in curves) < 2:
        raise FigureUnavailable("no run solved more than one episode: success-episodes shows when")
    panel = Panel("episodes solved", "mean number of training episodes that have reached the goal", curves)
    details = KEPT if results.has_early_success else ""
    return Chart([panel], "episode").drawing("Episodes solved", details, note)
