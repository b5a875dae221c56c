"""What a scene is: an environment drawn on axes, and moved from step to step."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

Settings = Mapping[str, Any]
"""The settings of an environment, as the manifest has them."""

GROUND, METAL, GOAL, TRAIL = "#555555", "#4A5A68", "#CDE8DB", "#B9C6D0"
"""Colours of what stands still, of what moves, of the goal, and of where something was."""

TRAIL_STEPS = 60


class Scene(abc.ABC):
    """A drawing that is made once, on axes of its own, and then moved; lengths in metres.

    Attributes:
        keys: Settings of the environment that the drawing needs.
    """

    keys: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def __init__(self, axes: Axes, env: Settings): ...

    @abc.abstractmethod
    def move(self, observation: NDArray[np.float64]) -> None:
        """Draw what was observed."""


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
