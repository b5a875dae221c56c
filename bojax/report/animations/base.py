"""What a scene is: an environment drawn on axes, and moved from step to step."""

import abc
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

GROUND, METAL, GOAL, TRAIL = "#555555", "#4A5A68", "#CDE8DB", "#B9C6D0"
"""Colours of what stands still, of what moves, of the goal, and of where something was."""

TRAIL_STEPS = 60


@dataclass(frozen=True)
class Moment:
    """What is recorded of a step.

    Attributes:
        observation: What was seen when it was taken, `[D]`.
        action: What was done then, `[A]`.
        frame: What the environment keeps for its animation, see `Env.frame`, `[Q]`; empty where it keeps
            nothing.
    """

    observation: NDArray[np.float64]
    action: NDArray[np.float64]
    frame: NDArray[np.float64]


class Scene(abc.ABC):
    """A drawing that is made once, on axes of its own, and then moved; lengths in metres.

    Attributes:
        has_trail: Whether it shows where something was: then it is moved through all steps, not only through
            those of which there is a picture.
        time_step: Seconds of a step, where they are no setting; 0 for a step that is no time.
    """

    has_trail: ClassVar[bool] = True
    time_step: ClassVar[float] = 0.0

    @abc.abstractmethod
    def __init__(self, axes: Axes, env: Any): ...

    @abc.abstractmethod
    def move(self, moment: Moment) -> None:
        """Draw a step."""

    def close(self) -> None:  # noqa: B027
        """Give back what the drawing needed of the machine."""


class Trail:
    """The way of a point over the last steps."""

    def __init__(self, axes: Axes):
        (self._line,) = axes.plot([], [], color=TRAIL, linewidth=1.2, zorder=1)
        self._points: list[tuple[float, float]] = []

    def add(self, x: float, y: float) -> None:
        """The point has come here."""
        self._points = [*self._points, (x, y)][-TRAIL_STEPS:]
        self._line.set_data(*np.transpose(self._points))


def stage(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Empty axes of equal scale over these ranges."""
    axes.set_xlim(*x)
    axes.set_ylim(*y)
    axes.set_aspect("equal")
    axes.set_axis_off()


def rod(axes: Axes, colour: str, width: float = 9.0) -> Line2D:
    """A rigid link, to be given its ends by `set_data`."""
    (line,) = axes.plot([], [], color=colour, linewidth=width, solid_capstyle="round", zorder=3)
    return line


def joint(axes: Axes, size: float = 6.0) -> Line2D:
    """A hinge, to be given its place by `set_data`."""
    style = {"markerfacecolor": "white", "markeredgecolor": "#222222", "markeredgewidth": 1.2}
    (dot,) = axes.plot([0.0], [0.0], "o", markersize=size, zorder=4, **style)
    return dot
