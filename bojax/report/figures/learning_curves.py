"""Mean return by episode: Figs. 5.2 to 5.5 of the thesis, with the bands that it leaves out."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from bojax.report import statistics, style
from bojax.report.drawing.base import Drawing, Undrawable, drawn_points
from bojax.report.drawing.curves import Band, add_curves, add_names, curve_figure
from bojax.report.source import Point, Results
from bojax.report.text import counted, number

RANK = 30

_PANELS = {"train": "return", "test": "return of tests"}
_TAIL = 0.05
"""Share of the means at either end that need not be on the axis where they would flatten the rest."""


def draw(results: Results) -> Drawing:
    """The return of every training episode, and below it of the tests after it where there are some.

    `report.rolling` draws the mean of each run over so many episodes up to each; `report.best_return` is
    a line.
    """
    if "return" not in results.episodes:
        raise Undrawable("there is no episodes.parquet with a return")
    points, note = drawn_points(results)
    rolling = int(results.report.rolling or 1)
    phases = [phase for phase in _PANELS if (results.episodes["phase"] == phase).any()]
    curves = {
        phase: {
            point.index: statistics.mean_band(
                rolling_mean(results.by_episode(point, "return", phase), rolling)
            )
            for point in points
        }
        for phase in phases
    }
    if not any(np.isfinite(mean).sum() > 1 for mean, _, _ in curves[phases[0]].values()):
        raise Undrawable("no run had more than one episode")
    best = results.report.best_return
    figure, grid = curve_figure(points, len(phases))
    is_cut = False
    for axes, phase in zip(grid[:, 0], phases, strict=True):
        add_curves(axes, points, curves[phase], _PANELS[phase], first=1)
        if isinstance(best, int | float):
            axes.axhline(best, color=style.FAINT, linewidth=1.0, linestyle=(0, (4, 3)), zorder=0.8)
        is_cut |= limit(axes, curves[phase], [] if best is None else [float(best)])
    grid[-1, 0].set_xlabel("episode")
    add_names(figure, grid[0, 0], points, curves[phases[0]])
    return Drawing(
        figure=figure,
        title="Learning curves",
        caption=_caption(results, points, phases, rolling, is_cut) + note,
        alt=f"Line chart of the mean return over {counted(results.num_episodes, 'episode')}. In the last "
        f"tenth of the episodes: {_ends(points, curves[phases[0]])}.",
    )


def rolling_mean(values: statistics.Floats, width: int) -> statistics.Floats:
    """Mean over the last `width` columns up to each, of those that are there, NaN where none is."""
    if width == 1:
        return values
    is_there = np.isfinite(values)
    sums, counts = (
        np.cumsum(np.pad(table, ((0, 0), (width, 0))), axis=1)
        for table in (np.where(is_there, values, 0.0), is_there.astype(np.float64))
    )
    total, count = sums[:, width:] - sums[:, :-width], counts[:, width:] - counts[:, :-width]
    means = np.divide(total, count, out=np.full(values.shape, np.nan), where=count > 0.5)
    return np.where(is_there, means, np.nan)


def limit(axes: Axes, curves: Mapping[int, Band], lines: Sequence[float]) -> bool:
    """Limits of the vertical axis by the bulk of the curves; whether something lies beyond them."""
    means = np.concatenate([mean[np.isfinite(mean)] for mean, _, _ in curves.values()])
    if not means.size:
        return False
    low = float(np.quantile(means, _TAIL, method="higher"))
    high = float(np.quantile(means, 1 - _TAIL, method="lower"))
    low, high = min([low, *lines]), max([high, *lines])
    ends = [bound[np.isfinite(bound)] for band in curves.values() for bound in band]
    least, most = (np.concatenate(ends).min(), np.concatenate(ends).max()) if ends else (low, high)
    # All of it, unless the extremes would take more than three fifths of the axis from the rest.
    if most - least > 2.5 * (high - low) > 0:
        least, most = max(least, low - 0.25 * (high - low)), min(most, high + 0.25 * (high - low))
    least, most = min([least, *lines]), max([most, *lines])
    pad = 0.04 * (most - least) or 0.5
    axes.set_ylim(least - pad, most + pad)
    return bool(means.min() < least or means.max() > most)


def _caption(
    results: Results, points: Sequence[Point], phases: Sequence[str], rolling: int, is_cut: bool
) -> str:
    sizes = sorted({int(results.runs_of(point)["run"].size) for point in points})
    runs = counted(sizes[-1], "run") if len(sizes) == 1 else f"{sizes[0]} to {sizes[-1]} runs"
    told = f"Mean return by training episode of {runs} each, with pointwise 95% bootstrap bands."
    if rolling > 1:
        told += f" Of each run the mean over the last {counted(rolling, 'episode')} is taken."
    if "test" in phases:
        told += " Below: the tests after each, which exploit and learn nothing."
    if any(np.isnan(results.by_episode(point, "return", phases[0])).any() for point in points):
        told += " A run that has ended is left out from there on."
    if results.report.best_return is not None:
        told += f" Dashed: the best return possible, {number(results.report.best_return)}."
    return told + (" What lies beyond the axis is cut off." if is_cut else "")


def _ends(points: Sequence[Point], curves: Mapping[int, Band]) -> str:
    told = []
    for point in points:
        mean = curves[point.index][0]
        known = mean[-max(1, len(mean) // 10) :]
        known = known[np.isfinite(known)]
        told.append(f"{point.name} {number(float(known.mean()) if known.size else None)}")
    return ", ".join(told)
