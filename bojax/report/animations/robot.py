"""A scene of a robot in its world, rendered by MuJoCo."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from typing_extensions import override

from bojax.report.animations.rendering import Renderer
from bojax.report.animations.scenes import Moment, Scene
from bojax.report.statistics import Floats
from bojax.results.store import ResultsError
from bojax.robots import models
from bojax.robots.models import RobotModel


class RobotScene(Scene):
    """An image of MuJoCo that fills the axes and is updated by frames."""

    has_trail = False

    def __init__(self, axes: Axes, env: RobotModel):
        axes.set_axis_off()
        box = axes.get_window_extent()
        width, height = round(box.width), round(box.height)
        self._renderer = Renderer(env, width, height)
        blank = np.full((height, width, 3), 255, np.uint8)
        self._picture = axes.imshow(blank, aspect="auto", interpolation="nearest")

    @override
    def move(self, moment: Moment) -> None:
        self.show(moment.frame)

    def show(self, frame: Floats) -> None:
        """Show a frame, as `Renderer.image` takes it."""
        try:
            self._picture.set_data(self._renderer.image(frame))
        except ValueError as error:
            raise ResultsError(f"the model differs from the one that was simulated: {error}") from error

    @override
    def close(self) -> None:
        self._renderer.close()


def compiled(path: Path | None, make: Callable[[], RobotModel]) -> RobotModel:
    """The model of an MJCF file, or else the one that a function makes; compiled once.

    Raises:
        ResultsError: The file cannot be read, or MuJoCo refuses the model.
    """
    try:
        model = make() if path is None else models.from_file(path)
        model.compiled()
    except ValueError as error:
        raise ResultsError(str(error)) from error
    return model


def is_free(model: RobotModel) -> bool:
    """Whether the first joint is free: generalised positions begin with a position and a quaternion."""
    return model.compiled().nq >= 7 and model.compiled().jnt_type[0] == models.mujoco.mjtJoint.mjJNT_FREE
