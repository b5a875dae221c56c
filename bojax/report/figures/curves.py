"""Curves over steps and episodes: rewards, returns and successes."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from bojax.report import style
from bojax.report.baseline import NOTE, baselines
from bojax.report.budgets import KEPT, within_budget
from bojax.report.drawing.base import Drawing, FigureUnavailable, drawn_points
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.source import Results
from bojax.report.statistics import Floats
from bojax.report.text import counted, number

_PANELS = {
    "train": ("return", "mean return in training"),
    "test": ("return of tests", "mean return of the tests after each episode, which do not explore"),
}
"""Label and quantity of the panel of each phase."""

_TAIL = 0.05
"""Share of the means at either end that may lie beyond the axis where they would flatten the others."""


def accumulated_reward(results: Results) -> Drawing:
    """Every planner's mean accumulated reward by step, from 0 at step 0 (Fig. 4.6 of the thesis)."""
    if any(point.is_learning for point in results.points):
        raise FigureUnavailable("a run of a learner has many episodes: learning-curves shows them")
    points, note = drawn_points(results)
    curves, left_out = [], 0
    for point in points:
        values = results.by_step(point, "accumulated_reward")
        is_finite = np.isfinite(values[:, : (point.time_limit or results.num_steps) + 1]).all(axis=1)
        left_out += int((~is_finite).sum())
        curves.append(Curve.numbered(point, values[is_finite], first=0))
    details = "A run that has ended keeps its last value."
    if left_out:
        details += f" Left out: {counted(left_out, 'run')} with a non-finite value."
    panel = Panel("accumulated reward", "mean accumulated reward", curves)
    return Chart([panel], "step").drawing("Accumulated reward", details, note)


def success(results: Results) -> Drawing:
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


def learning_curves(results: Results) -> Drawing:
    """Mean return by training episode and, below, of any tests after it (Figs. 5.2 to 5.5 of the thesis)."""
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
            left_out = "A run that ended otherwise is left out after its last episode."
            missing = left_out if phase == "train" else ""
            panels.append(Panel(label, quantity, curves, missing=missing))
    best = results.report.best_return
    chart, is_cut = Chart(panels, "episode"), False
    for axes, panel in zip(chart.axes, panels, strict=True):
        if best is not None:
            axes.axhline(best, color=style.FAINT, linewidth=1.0, linestyle=(0, (4, 3)), zorder=0.8)
        is_cut |= limit(axes, panel, [] if best is None else [best])
    averaged = f"The return of each run is its mean over the last {counted(rolling, 'episode')}."
    details = [
        KEPT if results.has_early_success else "",
        averaged if rolling > 1 else "",
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


def success_episodes(results: Results) -> Drawing:
    """Share of runs that have reached the goal by each training episode (Table 5.3 of the thesis)."""
    if not results.num_episodes:
        raise FigureUnavailable("the results have no episodes")
    points, note = drawn_points(results)
    when = [results.runs_of(point)["episodes_to_goal"].astype(np.float64) for point in points]
    others = baselines(results)
    firsts = [*when, *(each.first for each in others)]
    latest = max(first[np.isfinite(first)].max(initial=1) for first in firsts)
    longest = max([results.num_episodes, *(each.success.shape[1] for each in others)])
    last = min(longest, max(10, int(1.2 * latest)))  # soon after the last run that reaches it
    x = np.arange(last + 1.0)
    curves = []
    for point, first in zip(points, when, strict=True):
        share = (first[:, None] <= x).astype(np.float64)
        curves.append(Curve(point, x, within_budget(share, results.episodes_of(point), np.isfinite(first))))
    curves += [Curve(each.point, x, (each.first[:, None] <= x).astype(np.float64)) for each in others]
    what = "runs that have reached the goal"
    panel = Panel(f"{what} (%)", f"share of {what}", curves, is_share=True)
    constant = f"The shares stay as they are from episode {int(latest)} to the last, {longest}."
    details = [constant if last < longest else "", NOTE if others else ""]
    return Chart([panel], "episode").drawing("Success by episode", " ".join(filter(None, details)), note)


def solved_episodes(results: Results) -> Drawing:
    """Mean number of training episodes solved up to each one (Fig. 5.8b of the thesis)."""
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


def steps_to_goal(results: Results) -> Drawing:
    """Mean length of the successful training episodes (Fig. 5.7d of the thesis); below, the share of them."""
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
