"""A film of a planner on a state problem: the true state, and states of its belief, step by step."""

from collections.abc import Iterator

import numpy as np
from PIL import Image
from typing_extensions import override

from bojax.films.film import STILL, Film, blank, frames_of, photograph
from bojax.films.recorded import Trace
from bojax.report.drawing.sketches import draw_step, is_by_step, legend_of, num_steps, set_stage
from bojax.report.style import INK, drawn_text
from bojax.report.text import file_name

_SLOWEST, _FASTEST, _LONGEST = 0.5, 0.1, 15.0
"""Seconds of a step, at most and at least, and of a film whose steps are between them."""


class BeliefFilm(Film):
    """The steps of an episode, one after the other, as `StateProblem.sketch` draws them."""

    def __init__(self, trace: Trace):
        self._trace, self._is_by_step = trace, is_by_step(trace.sketch)
        self._steps = frames_of(num_steps(trace.sketch) + 1)
        self.name = f"{file_name(trace.point.name)}-run{trace.run}"
        self.num_images = len(self._steps)
        self.seconds = round(float(np.clip(_LONGEST / self.num_images, _FASTEST, _SLOWEST)), 2)

    @override
    def images(self) -> Iterator[Image.Image]:
        figure, trace = blank(4.2, 4.6), self._trace
        problem = trace.point.problem
        title = f"{problem.kind if problem else ''}: {trace.point.name}, run {trace.run}"
        figure.text(0.03, 0.945, drawn_text(title), color=INK, fontsize=10)
        status = figure.text(0.03, 0.895, "", color=INK, fontsize=10)
        axes = figure.add_axes((0.12, 0.17, 0.85, 0.68) if self._is_by_step else (0.02, 0.07, 0.96, 0.80))
        set_stage(axes, trace.sketch, trace.point.outline)
        if self._is_by_step:
            axes.set_xlabel("step", fontsize=9)
        entries = zip(*legend_of([trace.sketch]), strict=True)
        figure.legend(*entries, loc="lower center", ncols=4, frameon=False, handletextpad=0.1, fontsize=9)
        for step in self._steps.tolist():
            paid = f"return so far {trace.accumulated[step]:.4g}"
            status.set_text(f"step {step} of {num_steps(trace.sketch)}, {paid}")
            lines = draw_step(axes, trace.sketch, step)
            yield photograph(figure)
            for line in lines:
                line.remove()

    @override
    def still(self, share: float) -> Image.Image:
        figure, trace = blank(*STILL), self._trace
        axes = figure.add_axes((0.1, 0.1, 0.88, 0.88) if self._is_by_step else (0.01, 0.01, 0.98, 0.98))
        set_stage(axes, trace.sketch, trace.point.outline)
        draw_step(axes, trace.sketch, round(share * num_steps(trace.sketch)))
        return photograph(figure)
