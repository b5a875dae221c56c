"""A film of one episode of learning: a scene, the time, the return so far and the action."""

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from PIL import Image
from typing_extensions import override

from bojax.config.component import External
from bojax.films.film import FASTEST, SLOWEST, STILL, Film, blank, frames_of, photograph
from bojax.films.recorded import Episode
from bojax.films.scenes import SCENES, Replay, ReplayScene, RobotScene, Scene
from bojax.report.style import BLUE, FAINT, INK, drawn_text
from bojax.report.text import file_name
from bojax.results.store import ResultsError

_SIZE = (4.4, 4.0)


class LearningFilm(Film):
    """The steps of an episode, one after the other; a robot may be drawn from another MJCF file.

    With a replay, these are the pictures that the environment itself draws.
    """

    def __init__(self, episode: Episode, model: Path | None = None, replay: Replay | None = None):
        self._episode = episode
        self._kind, self._scene, self._time_step = _drawn(episode, model, replay)
        self._indices = frames_of(len(episode.observations))
        self.name = f"{file_name(episode.point.name)}-run{episode.run}-episode{episode.number}"
        self.num_images = len(self._indices)
        stride = (self._indices[-1] - self._indices[0]) / max(self.num_images - 1, 1)
        self.seconds = round(float(np.clip(stride * self._time_step, FASTEST, SLOWEST)), 2)

    @override
    def still(self, share: float) -> Image.Image:
        figure = blank(*STILL)
        with closing(self._scene(figure.add_axes((0.0, 0.0, 1.0, 1.0)))) as scene:
            self._move(scene, 0, round(share * (len(self._episode.observations) - 1)))
            return photograph(figure)

    @override
    def images(self) -> Iterator[Image.Image]:
        figure = blank(*_SIZE)
        with closing(self._scene(figure.add_axes((0.02, 0.16, 0.96, 0.70)))) as scene:
            episode = self._episode
            title = f"{self._kind}: {episode.point.name}, run {episode.run}, episode {episode.number}"
            figure.text(0.04, 0.945, drawn_text(title), color=INK, fontsize=10)
            status = figure.text(0.04, 0.885, "", color=INK, fontsize=10)
            outcome = figure.text(0.96, 0.885, "", color=BLUE, fontsize=10, ha="right", weight="bold")
            bars = figure.add_axes((0.20, 0.045, 0.72, 0.07))
            largest = np.maximum(np.abs(episode.actions).max(axis=0), 1e-9)
            num = len(largest)
            bars.set_xlim(-1.02, 1.02)
            bars.set_ylim(-0.6, num - 0.4)
            bars.set_axis_off()
            bars.axvline(0.0, color=FAINT, linewidth=1.0)
            drawn = bars.barh(np.arange(num), np.zeros(num), height=0.7, color=BLUE)
            figure.text(0.04, 0.08, "action", color=INK, fontsize=10, va="center")
            position = 0
            for index in self._indices.tolist():
                self._move(scene, position, index)
                position = index + 1
                seconds = f"{index * self._time_step:.2f} s, " if self._time_step else ""
                reward = f"return so far {episode.accumulated[index]:.4g}"
                status.set_text(f"{seconds}step {index + 1} of {len(episode.observations)}, {reward}")
                for bar, width in zip(drawn, episode.actions[index] / largest, strict=True):
                    bar.set_width(width)
                if index == self._indices[-1]:
                    outcome.set_text(episode.outcome)
                yield photograph(figure)

    def _move(self, scene: Scene, first: int, last: int) -> None:
        """Show the last of some steps, and before it those that leave a trail."""
        episode = self._episode
        for step in range(first if scene.has_trail else last, last + 1):
            scene.move(episode.observations[step], episode.actions[step], episode.frames[step])


def _drawn(
    episode: Episode, model: Path | None, replay: Replay | None
) -> tuple[str, Callable[[Axes], Scene], float]:
    """The kind of an environment, its scene, and the duration of a step in seconds; 0 if unknown."""
    env = episode.point.env
    assert env is not None
    kind = env.kind
    if replay is not None:
        return getattr(env, "id", kind), partial(ReplayScene, env=replay), replay.seconds
    if model is not None or (kind not in SCENES and episode.frames.shape[1] > 0):
        from bojax.films.robot_worlds import ENVS, compiled

        if model is not None or kind in ENVS:
            robot = compiled(model, lambda: ENVS[kind](env))
            substeps = (env.params if isinstance(env, External) else vars(env)).get("substeps", 1)
            return kind, partial(RobotScene, env=robot), float(robot.compiled().opt.timestep) * substeps
    if kind not in SCENES:
        raise ResultsError(
            f"no drawing of {kind} is known; known: {', '.join(SCENES)}; give the MJCF of a robot by --model"
        )
    return kind, partial(SCENES[kind], env=env), getattr(env, "time_step", SCENES[kind].time_step)
