"""The exploration value U over the first two observations after some episodes: Fig. 5.7 of the thesis."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from bojax.envs.settings import EnvironmentSettings
from bojax.report import style
from bojax.report.columns import Columns
from bojax.report.drawing.base import Drawing, Undrawable
from bojax.report.drawing.maps import draw_scale
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.report.text import joined, number

RANK = 70

MAX_ROWS = 3
MAX_COLUMNS = 4


@dataclass(frozen=True)
class _Row:
    """The maps of one recorded run: U `[K, R, R]`, the first observation along the first axis of a map."""

    point: Point
    run: int
    episodes: list[int]
    values: Floats
    low: Floats
    high: Floats


def draw(results: Results) -> Drawing:
    """One row per recorded run, one panel per kept episode, which shows the trajectory of the episode."""
    rows = _rows(results)
    columns = max(len(row.episodes) for row in rows)
    figure, grid = style.figure(1.35 + 1.45 * len(rows), len(rows), columns, sharex=True, sharey=True)
    values = np.concatenate([row.values.ravel() for row in rows])
    norm = Normalize(float(values.min()), float(values.max()))
    image = None
    for axes_row, row in zip(grid, rows, strict=True):
        steps = _steps(results, row)
        for axes, episode, value in zip(axes_row, row.episodes, row.values, strict=False):
            image = axes.imshow(
                value.T,
                origin="lower",
                extent=(row.low[0], row.high[0], row.low[1], row.high[1]),
                aspect="auto",
                norm=norm,
                cmap="viridis",
                interpolation="bilinear",
            )
            _draw_trajectory(axes, steps, episode)
            axes.set_xlim(row.low[0], row.high[0])
            axes.set_ylim(row.low[1], row.high[1])
            axes.xaxis.set_major_locator(MaxNLocator(nbins=4 if columns < 3 else 2))
            axes.yaxis.set_major_locator(MaxNLocator(nbins=4))
            axes.tick_params(length=3, labelsize=8.5)
        for axes in axes_row[len(row.episodes) :]:
            axes.set_axis_off()
    for axes, episode in zip(grid[0], rows[0].episodes, strict=False):
        axes.set_title(f"episode {episode}", pad=4)
    first, second = _axis_names(rows)
    figure.supylabel(second, fontsize=10.5)
    grid[-1, columns // 2].set_xlabel(first)
    if len(rows) > 1:
        for axes_row, row in zip(grid, rows, strict=True):
            axes_row[-1].set_ylabel(_row_name(rows, row), rotation=270, labelpad=11, fontsize=9)
            axes_row[-1].yaxis.set_label_position("right")
    if image is not None:
        draw_scale(figure, image, grid.flat, aspect=32).set_label("exploration value U")
    named = joined(f"{row.point.name}, run {row.run}" for row in rows)
    if len({row.point.index for row in rows}) == 1 < len(rows):
        named = f"{rows[0].point.name}, runs {joined(row.run for row in rows)}"
    return Drawing(
        figure=figure,
        title="Exploration values and trajectories",
        caption=f"U at the middle action over {first} and {second}, after single training episodes, on a "
        "common scale: bright where few observations were made. Lines: the trajectory of the episode, from "
        f"the circle to the cross, or to the star if the last step was rewarded. First recorded runs: "
        f"{named}.",
        alt=f"Maps of the exploration value over {first} and {second} after {_told(rows[0])}, with the "
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
                known = [int(episode) for episode in episodes[kept]][:MAX_COLUMNS]
                rows.append(
                    _Row(point, run, known, maps[kept, 1][:MAX_COLUMNS], arrays["low"], arrays["high"])
                )
    if not rows:
        raise Undrawable("no maps over two observations in arrays/; map_episodes records them")
    points = list(dict.fromkeys(row.point.index for row in rows))
    if len(points) > 1:  # the first run of each point, rather than all runs of the first point
        rows = [next(row for row in rows if row.point.index == index) for index in points]
    env = rows[0].point.env
    return [row for row in rows if row.point.env and env and row.point.env.kind == env.kind][:MAX_ROWS]


def _steps(results: Results, row: _Row) -> Columns:
    rows = results.steps_of(row.point)
    if not {"episode", "observation_0", "observation_1"} <= rows.keys():
        return {}
    return {name: column[rows["run"] == row.run] for name, column in rows.items()}


def _draw_trajectory(axes: Axes, steps: Columns, episode: int) -> None:
    if not steps:
        return
    there = steps["episode"] == episode
    x, y = steps["observation_0"][there], steps["observation_1"][there]
    if not x.size:
        return
    outline = [withStroke(linewidth=2.2, foreground="#00000080")]
    axes.plot(x, y, color="white", linewidth=1.0, path_effects=outline, zorder=3)
    is_rewarded = float(steps["reward"][there][-1]) > 0
    marks: dict[str, Any] = {"color": "white", "edgecolors": style.INK, "linewidths": 0.8, "zorder": 4}
    axes.scatter(x[:1], y[:1], s=26, marker="o", **marks)
    axes.scatter(
        x[-1:],
        y[-1:],
        s=80 if is_rewarded else 40,
        marker="*" if is_rewarded else "X",
        **marks,
        clip_on=False,
    )


def _axis_names(rows: Sequence[_Row]) -> tuple[str, str]:
    env = rows[0].point.env
    return (env if isinstance(env, EnvironmentSettings) else EnvironmentSettings).observation_names


def _row_name(rows: Sequence[_Row], row: _Row) -> str:
    is_one = len({other.point.index for other in rows}) == 1
    return f"run {row.run}" if is_one else style.wrapped(row.point.name, 18)


def _told(row: _Row) -> str:
    means = [number(float(value.mean())) for value in row.values]
    return joined(
        [f"episode {episode} (mean {mean})" for episode, mean in zip(row.episodes, means, strict=True)]
    )
