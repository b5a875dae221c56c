"""A robot in its world, as MuJoCo draws it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from typing_extensions import override

from bojax.report.animations.base import Moment, Scene, Settings
from bojax.report.animations.rendering import Renderer
from bojax.results.store import ResultsError
from bojax.robots import models
from bojax.robots.models import RobotModel


class RobotScene(Scene):
    """The picture of MuJoCo fills the axes; it is moved by frames."""

    has_trail = False

    def __init__(self, axes: Axes, model: RobotModel):
        axes.set_axis_off()
        box = axes.get_window_extent()
        width, height = round(box.width), round(box.height)
        self._renderer = Renderer(model, width, height)
        blank = np.full((height, width, 3), 255, np.uint8)
        self._picture = axes.imshow(blank, aspect="auto", interpolation="nearest")

    @override
    def move(self, moment: Moment) -> None:
        self.show(moment.frame)

    def show(self, frame: NDArray[np.float64]) -> None:
        """Draw a frame: generalised positions and those of bodies moved by hand, see `Renderer`."""
        try:
            self._picture.set_data(self._renderer.image(frame))
        except ValueError as error:
            raise ResultsError(f"another model than the one that was simulated: {error}") from error

    @override
    def close(self) -> None:
        self._renderer.close()


def known(
    makers: Mapping[str, Callable[..., RobotModel]], kind: str, part: str, settings: Settings, *arguments: Any
) -> RobotModel | None:
    """The model of an environment or vehicle of this kind; None if the kind is not among `makers`.

    Args:
        makers: Functions from settings and `arguments` to a model, by kind.
        kind: Kind of the environment or of the vehicle.
        part: Key of the manifest under which the settings are stored.
        settings: The settings.
        arguments: Further arguments of the function.

    Raises:
        ResultsError: A setting is missing, or MuJoCo refuses the model.
    """
    if kind not in makers:
        return None
    try:
        return _accepted(makers[kind](settings, *arguments))
    except KeyError as error:
        raise ResultsError(
            f"manifest.json: {part}: no {error.args[0]}, which drawing {kind} needs"
        ) from error
    except ValueError as error:
        raise ResultsError(f"manifest.json: {part}: {error}") from error


def from_file(path: Path) -> RobotModel:
    """A model of one's own.

    Raises:
        ResultsError: It cannot be read, or MuJoCo refuses it.
    """
    try:
        return _accepted(models.from_file(path))
    except ValueError as error:
        raise ResultsError(str(error)) from error


def time_step(model: RobotModel) -> float:
    """Seconds of a step of the physics."""
    return float(model.compiled().opt.timestep)


def is_free(model: RobotModel) -> bool:
    """Whether generalised positions begin with a body's position and quaternion: the first joint is free."""
    return model.compiled().nq >= 7 and model.compiled().jnt_type[0] == models.mujoco.mjtJoint.mjJNT_FREE


def _accepted(model: RobotModel) -> RobotModel:
    model.compiled()
    return model
