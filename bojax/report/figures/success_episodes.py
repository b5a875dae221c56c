"""Share of runs that have reached the goal by each training episode (Table 5.3 of the thesis)."""

import numpy as np

from bojax.report.baseline import NOTE, baselines
from bojax.report.budgets import within_budget
from bojax.report.drawing.base import Drawing, FigureUnavailable, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Results

RANK = 40


def draw(results: Results) -> Drawing:
    """Success by episode; the axis ends soon after the last run that reaches the goal for the first time."""
    if not results.num_episodes:
        raise FigureUnavailable("the results have no episodes")
    points, note = drawn_points(results)
    when = [results.runs_of(point)["episodes_to_goal"].astype(np.float64) for point in points]
    others = baselines(results)
    firsts = [*when, *(each.first for each in others)]
    latest = max(first[np.isfinite(first)].max(initial=1) for first in firsts)
    longest = max([results.num_episodes, *(each.success.shape[1] for each in others)])
    last = min(longest, max(10, int(1.2 * latest)))
    x = np.arange(last + 1.0)
    shares = [
        within_budget(
            (first[:, None] <= x).astype(np.float64), results.episodes_of(point), np.isfinite(first)
        )
        for point, first in zip(points, when, strict=True)
    ]
    curves = [Curve(point, x, share) for point, share in zip(points, shares, strict=True)]
    curves += [Curve(each.point, x, (each.first[:, None] <= x).astype(np.float64)) for each in others]
    what = "runs that have reached the goal"
    panel = Panel(f"{what} (%)", f"share of {what}", curves, is_share=True)
    constant = f"The shares stay as they are from episode {int(latest)} to the last, {longest}."
    details = [constant if last < longest else "", NOTE if others else ""]
    return Chart([panel], "episode").drawing("Success by episode", " ".join(filter(None, details)), note)
