"""Mean return by episode: Figs. 5.2 to 5.5 of the thesis, with bands."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from bojax.report import style
from bojax.report.baseline import NOTE, baselines
from bojax.report.budgets import KEPT
from bojax.report.drawing.base import Drawing, FigureUnavailable, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Results
from bojax.report.statistics import Floats
from bojax.report.text import counted, number

RANK = 30

_PANELS = {
    "train": ("return", "mean return in training"),
    "test": ("return of tests", "mean return of the tests after each episode, which do not explore"),
}
"""Label and quantity of the panel of each phase."""

_TAIL = 0.05
"""Share of the means at either end that may lie beyond the axis where they would flatten the others."""


def draw(results: Results) -> Drawing:
    """The return of every training episode and, below it, of the tests after it where there are any.

    `report.rolling` is the number of episodes over which the return of each run is averaged up to each
    episode; `report.best_return` is drawn as a line.
    """
    if results.num_episodes < 2:
        raise FigureUnavailable("no run had more than one episode")
    points, note = drawn_points(results)
    rolling = results.report.rolling or 1
    panels, others = [], baselines(results)
    for phase, (label, quantity) in _PANELS.items():
        if (results.episodes["phase"] == phase).any():
            tables = [rolling_mean(results.by_episode(point, "return", phase), rolling) for point in points]
            curves = [Curve.numbered(*pair, first=1) for pair in zip(points, tables, strict=True)]
            if phase == "train":
                tables = [rolling_mean(each.returns[:, : results.num_episodes], rolling) for each in others]
                pairs = zip((each.point for each in others), tables, strict=True)
                curves += [Curve.numbered(*pair, first=1) for pair in pairs]
            missing = (
                "A run that ended otherwise is left out after its last episode." if phase == "train" else ""
            )
            panels.append(Panel(label, quantity, curves, missing=missing))
    best = results.report.best_return
    chart, is_cut = Chart(panels, "episode"), False
    for axes, panel in zip(chart.axes, panels, strict=True):
        if best is not None:
            axes.axhline(best, color=style.FAINT, linewidth=1.0, linestyle=(0, (4, 3)), zorder=0.8)
        is_cut |= limit(axes, panel, [] if best is None else [best])
    details = [
        KEPT if results.has_early_success else "",
        f"The return of each run is its mean over the last {counted(rolling, 'episode')}."
        if rolling > 1
        else "",
        "" if best is None else f"Dashed: the best return possible, {number(best)}.",
        "Extreme values lie beyond the axis." if is_cut else "",
        NOTE if others else "",
    ]
    return chart.drawing("Learning curves", " ".join(filter(None, details)), note)


def rolling_mean(values: Floats, width: int) -> Floats:
    """Mean of the known values among the last `width` columns up to each; NaN where a value is missing."""
    if width == 1:
        return values
    is_there = np.isfinite(values)
    tables = np.stack([np.where(is_there, values, 0.0), is_there])
    sums = np.cumsum(np.pad(tables, ((0, 0), (0, 0), (width, 0))), axis=2)
    total, count = sums[:, :, width:] - sums[:, :, :-width]
    means = np.divide(total, count, out=np.full(values.shape, np.nan), where=count > 0.5)
    return np.where(is_there, means, np.nan)


def limit(axes: Axes, panel: Panel, lines: Sequence[float]) -> bool:
    """Set the limits of the vertical axis by the bulk of the means; whether a mean lies beyond them.

    `lines` and the ends of the curves, where their names stand, are always within them.
    """
    means = np.concatenate([mean for mean, _, _ in panel.bands])
    bounds = np.concatenate([bound for band in panel.bands for bound in band])
    means, bounds = means[np.isfinite(means)], bounds[np.isfinite(bounds)]
    if not means.size:
        return False
    ranked, tail = np.sort(means), int(_TAIL * means.size)
    curves = [mean[np.isfinite(mean)] for mean, _, _ in panel.bands]
    shown = [*lines, *(float(curve[-1]) for curve in curves if curve.size)]
    low, high = min([ranked[tail], *shown]), max([ranked[-1 - tail], *shown])
    least, most = bounds.min(), bounds.max()
    # Everything is shown, unless the extremes would take more than three fifths of the axis.
    if most - least > 2.5 * (high - low) > 0:
        least, most = max(least, low - 0.25 * (high - low)), min(most, high + 0.25 * (high - low))
    least, most = min([least, *lines]), max([most, *lines])
    pad = 0.04 * (most - least) or 0.5
    axes.set_ylim(least - pad, most + pad)
    return bool(means.min() < least or means.max() > most)
