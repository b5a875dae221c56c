"""Final return of every run, one dot per run: means hide that returns fall into separate groups."""

import numpy as np

from bojax.report import statistics, style
from bojax.report.drawing.base import Drawing, FigureUnavailable, drawn_points, set_rows
from bojax.report.source import Results
from bojax.report.text import number

_BINS = 90
_HALF_ROW = 0.38
_MAX_DOTS = 400


def returns(results: Results) -> Drawing:
    """A swarm of dots per point; below it, the mean with its 95% interval."""
    points, note = drawn_points(results)
    returns = [results.runs_of(point)[results.return_column].astype(np.float64) for point in points]
    samples = [values[np.isfinite(values)] for values in returns]
    everything = np.concatenate(samples)
    if not everything.size:
        raise FigureUnavailable("no run has a finite return")
    edges = np.linspace(everything.min(), everything.max(), _BINS + 1)
    figure, grid = style.figure(0.95 + 0.62 * len(points))
    axes = grid[0, 0]
    means = []
    for row, (point, sample, look) in enumerate(zip(points, samples, style.looks(points), strict=True)):
        dots, offsets = swarm(sample, edges)
        axes.scatter(dots, row + offsets, s=7, color=look["color"], alpha=0.55, linewidths=0)
        if sample.size:
            mean = statistics.mean_interval(sample)
            means.append(f"{point.name} {number(mean.estimate)}")
            below = row + float(offsets.max()) + 0.11  # on the dots it would hide them
            axes.plot([mean.low, mean.high], [below, below], color=style.INK, linewidth=1.8, zorder=4)
            axes.scatter([mean.estimate], [below], marker="D", s=22, color=style.INK, linewidths=0, zorder=5)
    set_rows(axes, points, bottom=0.6, ticks=5, name_width=14)
    what = "final return of every run"
    if any(point.is_learning for point in points):
        what = "return of every run's last training episode"
    axes.set_xlabel(what)
    return Drawing(
        figure=figure,
        title="Distribution of returns",
        caption=f"{what.capitalize()} (dots, stacked where they coincide) and the mean with its 95% "
        f"interval ({statistics.methods(map(len, samples))}; diamond and bar, below the dots).{note}",
        alt=f"Dot plot of the {what}. Means: {', '.join(means)}.",
    )


def swarm(sample: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions of dots at the centres of their bins, and vertical offsets that stack them around their row.

    A large sample is drawn as its quantiles. The stack of the fullest bin is not higher than the row.
    """
    dots = np.sort(sample)
    if dots.size > _MAX_DOTS:
        dots = np.quantile(dots, (np.arange(_MAX_DOTS) + 0.5) / _MAX_DOTS, method="inverted_cdf")
    bins = np.clip(np.searchsorted(edges, dots, side="right") - 1, 0, len(edges) - 2)
    middles = edges[:-1] + np.diff(edges) / 2
    counts = np.bincount(bins, minlength=len(edges) - 1)
    rank = np.arange(dots.size) - np.concatenate([[0], np.cumsum(counts)[:-1]])[bins]
    height = min(0.07, 2 * _HALF_ROW / max(1, counts.max(initial=1) - 1))
    return middles[bins], (rank - (counts[bins] - 1) / 2) * height
