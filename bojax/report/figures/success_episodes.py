"""Share of runs that have reached the goal by each training episode, with Wilson bands."""

import numpy as np

from bojax.report.columns import Columns
from bojax.report.drawing.base import Drawing, Undrawable, drawn_points
from bojax.report.drawing.curves import draw_curves
from bojax.report.drawing.success import ends, success_curves
from bojax.report.source import Results

RANK = 40


def draw(results: Results) -> Drawing:
    """Success by episode: the first training episode of a learner that reached the goal (Table 5.3)."""
    if "episodes_to_goal" not in results.runs or not results.num_episodes:
        raise Undrawable("runs.parquet has no episodes_to_goal")
    points, note = drawn_points(results)
    latest = max(_first_successes(results.runs_of(point)).max(initial=1) for point in points)
    last = min(results.num_episodes, max(10, int(1.2 * latest)))
    curves = success_curves(results, points, last, _first_successes)
    if last < results.num_episodes:
        note = f" Nothing changes from episode {int(latest)} to the last, {results.num_episodes}.{note}"
    return Drawing(
        figure=draw_curves(
            points, curves, "runs that have reached the goal (%)", xlabel="episode", is_share=True
        ),
        title="Success by episode",
        caption="Share of runs that have reached the goal in one of the training episodes so far, with "
        f"pointwise 95% Wilson bands.{note}",
        alt="Line chart of the share of runs that have reached the goal by training episode. At the end: "
        f"{ends(points, curves)}.",
    )


def _first_successes(table: Columns) -> np.ndarray:
    when = table["episodes_to_goal"].astype(np.float64)
    return when[np.isfinite(when)]
