"""Scenes: an environment drawn on matplotlib axes and updated from step to step."""

import abc
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

GROUND, METAL, GOAL, TRAIL = "#555555", "#4A5A68", "#CDE8DB", "#B9C6D0"
"""Colours of fixed parts, moving parts, the goal, and trails."""

TRAIL_STEPS = 60


@dataclass(frozen=True)
class Moment:
    """The recorded data of one step.

    Attributes:
        observation: Observation before the step, `[D]`.
        action: Action taken, `[A]`.
        frame: Further data for animations, `[Q]`, recorded by `Env.frame`; Q may be 0.
    """

    observation: NDArray[np.float64]
    action: NDArray[np.float64]
    frame: NDArray[np.float64]


class Scene(abc.ABC):
    """A drawing that is created once on its own axes and then updated; lengths are in metres.

    Attributes:
        has_trail: Whether it shows past positions and so has to be updated at every step, even at
            steps without an image.
        time_step: Duration of a step in seconds if the environment has no such setting; 0 if steps have no
            duration.
    """

    has_trail: ClassVar[bool] = True
    time_step: ClassVar[float] = 0.0

    @abc.abstractmethod
    def __init__(self, axes: Axes, env: Any): ...

    @abc.abstractmethod
    def move(self, moment: Moment) -> None:
        """Show a step."""

    def close(self) -> None:  # noqa: B027
        """Release the resources of the drawing."""


class Trail:
    """The path of a point over the last steps."""

    def __init__(self, axes: Axes):
        (self._line,) = axes.plot([], [], color=TRAIL, linewidth=1.2, zorder=1)
        self._points: list[tuple[float, float]] = []

    def add(self, x: float, y: float) -> None:
        """Append the present position of the point."""
        self._points = [*self._points, (x, y)][-TRAIL_STEPS:]
        self._line.set_data(*np.transpose(self._points))


def stage(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Give axes equal scales, these ranges and no frame."""
    axes.set_xlim(*x)
    axes.set_ylim(*y)
    axes.set_aspect("equal")
    axes.set_axis_off()


def rod(axes: Axes, colour: str, width: float = 9.0) -> Line2D:
    """A rigid link; `set_data` sets its ends."""
    (line,) = axes.plot([], [], color=colour, linewidth=width, solid_capstyle="round", zorder=3)
    return line


def joint(axes: Axes, size: float = 6.0) -> Line2D:
    """A hinge; `set_data` sets its position."""
    style = {"markerfacecolor": "white", "markeredgecolor": "#222222", "markeredgewidth": 1.2}
    (dot,) = axes.plot([0.0], [0.0], "o", markersize=size, zorder=4, **style)
    return dot
