"""The exploration value U over the first two observations after some episodes: Fig. 5.7 of the thesis."""

from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from bojax.envs.settings import EnvironmentSettings
from bojax.report import style
from bojax.report.drawing.base import Drawing, FigureUnavailable
from bojax.report.drawing.maps import draw_scale
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.report.text import joined, number

MAX_ROWS = 3
MAX_COLUMNS = 4


class _Row(NamedTuple):
    """The maps of one recorded run: U `[K, R, R]`, the first observation along the first axis of a map."""

    point: Point
    run: int
    episodes: list[int]
    values: Floats
    low: Floats
    high: Floats


def value_maps(results: Results) -> Drawing:
    """One row per recorded run, one panel per kept episode, which shows the trajectory of the episode."""
    rows = _rows(results)
    columns = max(len(row.episodes) for row in rows)
    figure, grid = style.figure(1.35 + 1.45 * len(rows), len(rows), columns, sharex=True, sharey=True)
    values = np.concatenate([row.values.ravel() for row in rows])
    norm = Normalize(float(values.min()), float(values.max()))
    is_one, image = len({row.point.index for row in rows}) == 1, None
    for axes_row, row in zip(grid, rows, strict=True):
        (x_min, y_min), (x_max, y_max) = row.low[:2], row.high[:2]
        box: dict[str, Any] = {"extent": (x_min, x_max, y_min, y_max), "origin": "lower", "aspect": "auto"}
        for axes, episode, value in zip_longest(axes_row, row.episodes, row.values):
            if episode is None:
                axes.set_axis_off()
                continue
            image = axes.imshow(value.T, **box, norm=norm, cmap="viridis", interpolation="bilinear")
            _draw_trajectory(axes, results, row, episode)
            axes.set_xlim(x_min, x_max)
            axes.set_ylim(y_min, y_max)
            axes.xaxis.set_major_locator(MaxNLocator(nbins=4 if columns < 3 else 2))
            axes.yaxis.set_major_locator(MaxNLocator(nbins=4))
            axes.tick_params(length=3, labelsize=8.5)
        if len(rows) > 1:
            name = f"run {row.run}" if is_one else style.wrapped(row.point.name, 18)
            axes_row[-1].set_ylabel(name, rotation=270, labelpad=11, fontsize=9)
            axes_row[-1].yaxis.set_label_position("right")
    for axes, episode in zip(grid[0], rows[0].episodes, strict=False):
        axes.set_title(f"episode {episode}", pad=4)
    env = rows[0].point.env
    known = env if isinstance(env, EnvironmentSettings) else EnvironmentSettings
    first, second = known.observation_names
    figure.supylabel(second, fontsize=10.5)
    grid[-1, columns // 2].set_xlabel(first)
    if image is not None:
        bar = draw_scale(figure, image, grid.flat, aspect=32)
        bar.set_label("exploration value U (discounted exploration reward)")
    # Exploration rewards of these learners are at most 0, and so is the sum that U predicts.
    is_beyond = values.max() > 0 and rows[0].point.label.startswith("emu-q")
    beyond = " Above 0, where U cannot be, the model extrapolates: clips_u of the learner bounds its targets."
    named = joined(f"{row.point.name}, run {row.run}" for row in rows)
    if is_one and len(rows) > 1:
        named = f"{rows[0].point.name}, runs {joined(row.run for row in rows)}"
    means = [number(float(value.mean())) for value in rows[0].values]
    told = [f"episode {at} (mean {mean})" for at, mean in zip(rows[0].episodes, means, strict=True)]
    return Drawing(
        figure=figure,
        title="Exploration values and trajectories",
        caption=f"U at the middle action over {first} and {second}, after single training episodes, on a "
        "common scale: bright where few observations were made. Lines: the trajectory of the episode, from "
        f"the circle to the cross, or to the star if the last step was rewarded. First recorded runs: "
        f"{named}.{beyond * bool(is_beyond)}",
        alt=f"Maps of the exploration value over {first} and {second} after {joined(told)}, with the "
        f"trajectories of those episodes: {named}.",
    )


def _rows(results: Results) -> list[_Row]:
    rows = []
    for point in results.points:
        for run, arrays in results.arrays(point, "values"):
            if not {"maps", "episodes", "low", "high"} <= arrays.keys():
                continue
            maps, episodes = np.asarray(arrays["maps"], dtype=np.float64), np.asarray(arrays["episodes"])
            kept = np.isfinite(maps).reshape(len(maps), -1).all(axis=1)
            if maps.ndim == 4 and kept.any():
                known, values = episodes[kept][:MAX_COLUMNS].tolist(), maps[kept, 1][:MAX_COLUMNS]
                rows.append(_Row(point, run, known, values, arrays["low"], arrays["high"]))
    if not rows:
        raise FigureUnavailable("no maps over two observations in arrays/; map_episodes records them")
    points = list(dict.fromkeys(row.point.index for row in rows))
    if len(points) > 1:  # the first run of each point, rather than all runs of the first point
        rows = [next(row for row in rows if row.point.index == index) for index in points]
    env = rows[0].point.env
    return [row for row in rows if row.point.env and env and row.point.env.kind == env.kind][:MAX_ROWS]


def _draw_trajectory(axes: Axes, results: Results, row: _Row, episode: int) -> None:
    steps = results.steps_of(row.point)
    if not {"episode", "observation_0", "observation_1"} <= steps.keys():
        return
    there = (steps["run"] == row.run) & (steps["episode"] == episode)
    if not there.any():
        return
    x, y = steps["observation_0"][there], steps["observation_1"][there]
    outline = [withStroke(linewidth=2.2, foreground="#00000080")]
    axes.plot(x, y, color="white", linewidth=1.0, path_effects=outline, zorder=3)
    is_rewarded = float(steps["reward"][there][-1]) > 0
    marks: dict[str, Any] = {"color": "white", "edgecolors": style.INK, "linewidths": 0.8, "zorder": 4}
    axes.scatter(x[:1], y[:1], s=26, marker="o", **marks)
    end = {"s": 80, "marker": "*"} if is_rewarded else {"s": 40, "marker": "X"}
    axes.scatter(x[-1:], y[-1:], **end, **marks, clip_on=False)
