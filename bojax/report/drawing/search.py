"""Figures of a search over settings: slices through the posterior, and the best score by number of runs."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from bojax.report import style
from bojax.report.drawing.base import Drawing, panel_grid
from bojax.report.statistics import BAND
from bojax.report.text import counted, heading, number

if TYPE_CHECKING:
    from bojax.report.tuning import Tuning


def draw_slices(tuning: "Tuning") -> Drawing:
    """The posterior mean over each setting, the others as at the best point."""
    ranges, best = tuning.ranges, tuning.best
    figure, grid = panel_grid(len(ranges), lambda columns: 2.3, 0.4, sharey=True)
    tried = [point for point in tuning.points if point.score is not None]
    for index, (axes, each, curve) in enumerate(zip(grid.flat, ranges, tuning.slices, strict=False)):
        x, mean, std = (np.asarray(values) for values in (curve.values, curve.mean, curve.std))
        axes.fill_between(x, mean - BAND * std, mean + BAND * std, color=style.BLUE, alpha=0.18, linewidth=0)
        axes.plot(x, mean, color=style.BLUE)
        axes.plot(
            [point.values[index] for point in tried],
            [point.score for point in tried],
            "o",
            color=style.GREY,
            markersize=3,
            alpha=0.5,
            markeredgewidth=0,
        )
        axes.plot([best.values[index]], [best.mean], "D", color=style.ORANGE, markersize=6)
        if each.is_log:
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=_ticks(each.low, each.high)))
            axes.xaxis.set_minor_formatter(NullFormatter())
        else:
            axes.xaxis.set_major_locator(MaxNLocator(nbins=4))
        style.plain_ticks(axes.xaxis)
        style.plain_ticks(axes.yaxis)
        style.quiet_grid(axes)
        axes.set_xlabel(style.wrapped(each.key.replace(".", ". "), 22).replace(". ", "."))
    for row in grid:
        row[0].set_ylabel(_label(tuning))
    return Drawing(
        figure,
        f"{tuning.measure.words} over each setting".capitalize(),
        "Line and band: posterior mean and 95% interval of the mean without noise, the other settings as at "
        "the best point (diamond). Dots: scores of all points, whose other settings differ.",
        f"The model expects {number(best.mean)} at the best point.",
    )


def draw_progress(tuning: "Tuning") -> Drawing:
    """The score of every point, and the best score so far, by number of runs."""
    sign, runs = tuning.measure.sign, tuning.plan_.runs
    scores = np.asarray([np.nan if point.score is None else point.score for point in tuning.points])
    spent = runs * np.arange(1, len(scores) + 1)
    best = sign * np.fmax.accumulate(sign * scores)
    figure, ((axes,),) = style.figure(2.8)
    axes.plot(spent, scores, "o", color=style.GREY, markersize=3.5, alpha=0.6, markeredgewidth=0)
    axes.step(spent, best, where="post", color=style.BLUE)
    axes.axhline(tuning.best.mean, color=style.ORANGE, linewidth=1.2, linestyle=(0, (5, 2)))
    axes.set_xlabel("runs")
    axes.set_ylabel(_label(tuning))
    style.plain_ticks(axes.xaxis)
    style.plain_ticks(axes.yaxis)
    style.quiet_grid(axes)
    return Drawing(
        figure,
        "Best score by number of runs",
        f"Dots: score of each point, a mean of {counted(runs, 'run')}. Line: best score so far, optimistic "
        "because of the noise. Dashed line: posterior mean of the best point.",
        f"The best score after {spent[-1]} runs is {number(float(best[-1]))}.",
    )


def _label(tuning: "Tuning") -> str:
    return f"mean {heading(tuning.plan_.metric)}"


def _ticks(low: float, high: float) -> tuple[float, ...]:
    """Leading digits of the ticks of a logarithmic axis: more of them over a short range."""
    return (1.0,) if high / low > 100.0 else (1.0, 3.0) if high / low > 10.0 else (1.0, 2.0, 5.0)
