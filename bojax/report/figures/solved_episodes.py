"""Training episodes solved so far, by episode: Fig. 5.8b of the thesis, with the bands that it leaves out."""

import numpy as np

from bojax.report import statistics
from bojax.report.drawing.base import Drawing, Undrawable, drawn_points
from bojax.report.drawing.curves import draw_curves
from bojax.report.source import Results
from bojax.report.text import number

RANK = 50


def draw(results: Results) -> Drawing:
    """The mean over runs of the successes up to each episode; a run that has ended keeps its number."""
    if "success" not in results.episodes:
        raise Undrawable("there is no episodes.parquet with a success")
    points, note = drawn_points(results)
    solved = {
        point.index: np.cumsum(np.nan_to_num(results.by_episode(point, "success")), axis=1)
        for point in points
    }
    if max(values[:, -1].max(initial=0.0) for values in solved.values()) < 2:
        raise Undrawable("no run solved more than one episode: success-episodes shows when")
    # Nothing is solved before the first episode.
    curves = {
        index: statistics.mean_band(np.pad(values, ((0, 0), (1, 0)))) for index, values in solved.items()
    }
    ends = ", ".join(f"{point.name} {number(float(curves[point.index][0][-1]))}" for point in points)
    return Drawing(
        figure=draw_curves(points, curves, "episodes solved", xlabel="episode"),
        title="Episodes solved",
        caption="Mean number of training episodes so far that reached the goal, with pointwise 95% bootstrap "
        f"bands.{note}",
        alt="Line chart of the mean number of training episodes that reached the goal by training episode. "
        f"At the end: {ends}.",
    )
