"""Builds a comparison: reads folders and other curves, draws the figures and writes `comparison.html`."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from bojax.report import statistics, style
from bojax.report.comparing import tables
from bojax.report.comparing.logs.opening import opened
from bojax.report.comparing.methods import Measure, Method, Options, measured_by, methods_of
from bojax.report.comparing.scoring import Task, tasks_of
from bojax.report.drawing.base import MAX_POINTS, Drawing, FigureUnavailable, dot_plot, draw_intervals
from bojax.report.drawing.curves import Chart, Panel
from bojax.report.figures.curves import limit
from bojax.report.ranking import ENDS
from bojax.report.source import load
from bojax.report.template import fill
from bojax.report.text import counted, file_name, heading, joined, minus, number, percent, ranged
from bojax.results.store import write_content

PAGE = "comparison.html"


def compare(
    folders: Sequence[Path],
    files: Sequence[Path],
    out: Path,
    options: Options | None = None,
    command: str = "",
) -> Path:
    """Write a comparison into the folder `out` once all is ready, and return `comparison.html`.

    The files are CSV, or files and folders as other libraries write them.
    """
    options = options or Options()
    results, sources = [load(folder) for folder in folders], [opened(path) for path in files]
    has_logs = any(each.logs for each in sources)
    measure = measured_by(results, options, has_logs=has_logs)
    methods = methods_of(results, sources, measure)
    tasks = tasks_of(methods, measure, options.reference)
    images, sections = {}, []
    with style.settings():
        for number, task in enumerate(tasks, start=1):
            suffix = f"-{number}-{file_name(task.name)}" if len(tasks) > 1 else ""
            drawings = _drawings(task, measure)
            images |= {f"{name}{suffix}": drawing.files for name, drawing in drawings.items()}
            sections.append((task.name, [*drawings.values()], tables.scores(task, measure)))
    names = list(dict.fromkeys(each.name for each in methods))
    listed = f" ({joined(names)})" if len(names) <= MAX_POINTS else ""
    places = [task.name for task in tasks if task.name]
    where = f" on {joined(places)}" if places else ""
    sizes = [len(each.series) for each in methods]
    runs = ranged(sizes, "run")
    worlds = tables.differing_worlds(tasks)
    in_words = joined(worlds) if 0 < len(worlds) <= 4 else f"{len(worlds)} settings of their worlds"
    caution = f" The methods differ in {in_words}: their scores may not be comparable." if worlds else ""
    page = fill(
        "comparison.html.j2",
        title=f"Comparison: {heading(measure.column)}{where}",
        summary=f"{counted(len(names), 'method')}{listed} of "
        f"{counted(len({each.source for each in methods}), 'source')}, {runs} each. The score of a run is "
        f"the {_score(methods[0], measure)}{'; less is better' if measure.is_least else ''}."
        f"{tables.rule(methods[0], measure)}{caution}{tables.compiled_apart(results)}",
        counts=[],
        sections=sections,
        methods=statistics.methods(sizes),
        better="Newcombe" if min(sizes) < statistics.FEW else "bootstrap",
        overall=tables.overall(tasks, options.reference or tasks[0].reference.name, measure),
        settings=tables.settings(methods),
        sources=tables.sources(results, methods),
        provenance=[("command", command)] if command else [],
        footer="Written by bojax from the tables of these results.",
    )

    style.write_images(out, images)
    write_content(out / PAGE, page)
    return out / PAGE


def _drawings(task: Task, measure: Measure) -> dict[str, Drawing]:
    """The figures of a task by name, without those that cannot be drawn."""
    best = sorted(task.methods, key=lambda each: -measure.sign * np.nan_to_num(each.scores.mean()))
    best, note = best[:MAX_POINTS], ""
    if len(task.methods) > MAX_POINTS:
        note = f" Of {len(task.methods)} methods, the {MAX_POINTS} with the best mean score are drawn."
    shown = replace(task, methods=[each for each in task.methods if each in best])
    drawings = {}
    for name, draw in (("curves", _draw_curves), ("scores", _draw_scores)):
        with suppress(FigureUnavailable):
            drawings[name] = draw(shown, measure, note)
    return drawings


def _draw_curves(task: Task, measure: Measure, note: str) -> Drawing:
    curves = [each.curve for each in task.methods if each.curve is not None]
    left_out = sum(int(each.has_nan.sum()) for each in task.methods)
    if not curves:
        raise FigureUnavailable(f"{measure.column} has one value per run")
    # Means of several tests, and shares of episodes in a CSV file, lie between 0 and 1.
    is_share = measure.column == "success" and all(
        np.isin(each.values[np.isfinite(each.values)], (0.0, 1.0)).all() for each in curves
    )
    words = heading(measure.column)
    tests = " of the tests after each episode" if measure.options.phase == "test" else ""
    quantity = f"share of runs with success{tests}" if is_share else f"mean {words}{tests}"
    label = "success (%)" if is_share else words
    missing = "A run is left out before its first value."
    panel = Panel(label, quantity, curves, is_share=is_share, missing=missing)
    by_step = measure.axis == "step" and measure.kind == "learning"
    chart = Chart([panel], "environment step" if by_step else measure.axis)
    details = ["A run that has ended keeps its last value."]
    if left_out:
        details.append(f"Left out: {counted(left_out, 'run')} with a non-finite value.")
    if by_step:
        style.plain_ticks(chart.axes[0].xaxis)
        chart.axes[0].set_xticks(chart.axes[0].get_xticks()[::2])
        details.append("A value holds from the end of its episode to the end of the next.")
    if not is_share and limit(chart.axes[0], panel, []):
        details.append("Extreme values lie beyond the axis.")
    if any(curve.x[-1] > task.methods[0].at for curve in curves):
        chart.axes[0].axvline(task.methods[0].at, color=style.FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
        details.append(f"Dashed: {measure.unit} {task.methods[0].at:,.10g}, up to which scores are taken.")
    return chart.drawing("Curves", " ".join(details), note)


def _draw_scores(task: Task, measure: Measure, note: str) -> Drawing:
    methods, reference = task.methods, task.reference
    means = [each.mean for each in methods]
    iqms = [statistics.iqm_interval([each.scores]) for each in methods]
    better = [
        statistics.Interval() if each is reference else tables.improvement([(each, reference)], measure)
        for each in methods
    ]
    if not any(np.isfinite(interval.estimate) for interval in (*means, *iqms)):
        raise FigureUnavailable("no method has scores of all its runs")
    points = [each.point for each in methods]
    panels = {"mean": means, "IQM": iqms} | ({"P(better)": better} if len(methods) > 1 else {})
    figure, grid = dot_plot(points, 1, len(panels), ticks=2, spare=1.0, least=0.26)
    for axes, (title, intervals) in zip(grid[0], panels.items(), strict=True):
        draw_intervals(axes, points, intervals)
        axes.xaxis.set_major_formatter(lambda value, _: _tick(value))
        axes.set_title(title)
        if title == "P(better)":
            axes.set_xlim(-0.06, 1.06)
            axes.set_xticks([0, 0.5, 1], ["0", "50", "100%"])
            axes.axvline(0.5, color="#9A9A9A", linewidth=0.8, zorder=0.5)
    told = [
        f"{each.name}: mean {number(mean.estimate)}, IQM {number(middle.estimate)}"
        + (f", P(better) {percent(share.estimate)}" if each is not reference else "")
        for each, mean, middle, share in zip(methods, means, iqms, better, strict=True)
    ]
    more = f", and the probability that a run is better than one of {reference.name}"
    compared = more if len(panels) > 2 else ""
    return Drawing(
        figure=figure,
        title="Scores",
        caption=f"Mean and interquartile mean (IQM) of the score, the {_score(reference, measure)}{compared}"
        f", with 95% intervals.{note}",
        alt=f"Dot plots with intervals. {'; '.join(told)}.",
    )


def _tick(value: float) -> str:
    """A number that takes little room: `20k` for 20,000."""
    text = f"{value / 1000:g}k" if abs(value) >= 10_000 else f"{value:,.10g}"
    return minus(text)


def _score(method: Method, measure: Measure) -> str:
    """What the score of a run is, in words."""
    words = heading(measure.column)
    if not method.has_curve:
        return f"{words}, or the budget where it is not reached" if measure.column in ENDS else words
    if (last := measure.options.last) is not None:
        return f"mean {words} of the last {counted(last, 'value')} of the run up to the budget"
    if measure.kind == "planning":
        return f"last {words} up to the budget"
    return f"mean {words} over the last tenth of the run up to the budget"
