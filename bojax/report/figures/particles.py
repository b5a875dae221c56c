"""The belief of particles and the true state during the first recorded run of each point."""

from bojax.report import style
from bojax.report.drawing.base import Drawing, points_with
from bojax.report.drawing.sketches import draw_step, is_by_step, legend_of, num_steps, set_stage, sketches
from bojax.report.source import Results
from bojax.report.text import joined

MAX_ROWS = 6  # most rows that fit a screen; of more points, the best of each label is drawn

_SHARES = (0.0, 1 / 3, 2 / 3, 1.0)
"""Shares of an episode after which the belief is drawn."""


def particles(results: Results) -> Drawing:
    """One row per point: the belief at up to four times, or one panel with all steps of a number."""
    found, note = points_with(
        results, lambda point: sketches(results, point), "no recorded sketch of a state in arrays/", MAX_ROWS
    )
    shown = [(point, *next(iter(kept.items()))) for point, kept in found]
    lasts = [num_steps(sketch) for _, _, sketch in shown]
    if all(is_by_step(sketch) for _, _, sketch in shown):
        times = [[last] for last in lasts]
    else:  # in a short episode, several shares are of one step
        times = [sorted({round(share * last) for share in _SHARES}) for last in lasts]
    columns = max(map(len, times))
    figure, grid = style.figure((1.9 if columns == 1 else 1.35) * len(shown) + 0.5, len(shown), columns)
    looks, names = style.looks([each[0] for each in shown]), style.drawn_names([each[0] for each in shown])
    told = []
    for row, name, look, steps, (point, run, sketch) in zip(grid, names, looks, times, shown, strict=True):
        for axes in row[len(steps) :]:
            axes.set_axis_off()
        for axes, step in zip(row, steps, strict=False):
            set_stage(axes, sketch, point.outline)
            draw_step(axes, sketch, step, 0.6)
            axes.set_title("" if columns == 1 else f"step {step}", pad=3, fontsize=9)
        row[0].set_ylabel(style.wrapped(name, 19), color=look["color"], labelpad=3)
        told.append(f"{point.name}: run {run}, {steps[-1]} steps")
    if columns == 1:
        grid[-1, 0].set_xlabel("step")
    entries = zip(*legend_of([sketch for _, _, sketch in shown]), strict=True)
    figure.legend(*entries, loc="outside lower center", ncols=4, handletextpad=0.2)
    runs = joined(sorted({run for _, run, _ in shown}))
    num_drawn = max(next(iter(sketch.values())).shape[1] - 1 for _, _, sketch in shown)
    return Drawing(
        figure=figure,
        title="Belief during an episode",
        caption="Large dots: the true state, with its path over the last steps. Small dots: "
        f"{num_drawn} states of the belief, equal ones as one larger dot. Run {runs}.{note}",
        alt=f"The true state and states of the belief at some steps of an episode. {'; '.join(told)}.",
    )
