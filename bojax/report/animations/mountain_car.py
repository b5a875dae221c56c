"""The car in its valley; observations are position and velocity."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon
from matplotlib.transforms import Affine2D
from typing_extensions import override

from bojax.envs import settings
from bojax.report.animations.base import GOAL, GROUND, METAL, Moment, Scene, stage

_LEFT, _RIGHT = -1.2, 0.6


class MountainCar(Scene):
    """A hill of height sin(3 x), as Gym draws it, with a flag at the goal."""

    def __init__(self, axes: Axes, env: settings.MountainCar):
        stage(axes, (_LEFT - 0.08, _RIGHT + 0.08), (-0.12, 1.24))
        x = np.linspace(_LEFT, _RIGHT + 0.08, 200)
        axes.fill_between(x, -0.12, _height(x), color="#EDEDED", zorder=0)
        axes.plot(x, _height(x), color=GROUND, linewidth=1.6, zorder=2)
        axes.plot([_LEFT, _LEFT], [-0.12, 1.2], color=GROUND, linewidth=3.0, zorder=2)  # the wall
        goal = env.goal_position
        beyond = np.linspace(goal, _RIGHT + 0.08, 50)
        axes.fill_between(beyond, -0.12, _height(beyond), color=GOAL, zorder=1)
        foot = _height(goal)
        axes.plot([goal, goal], [foot, foot + 0.18], color=GROUND, linewidth=1.5, zorder=2)
        flag = [(goal, foot + 0.18), (goal, foot + 0.10), (goal - 0.10, foot + 0.14)]
        axes.add_patch(Polygon(flag, color="#D55E00", zorder=2))
        body = [
            (-0.075, 0.025),
            (0.075, 0.025),
            (0.075, 0.06),
            (0.035, 0.095),
            (-0.045, 0.095),
            (-0.075, 0.06),
        ]
        self._parts = [Polygon(body, color=METAL, zorder=4)]
        self._parts += [
            Circle((x, 0.025), 0.024, facecolor="white", edgecolor="#222222", zorder=5)
            for x in (-0.045, 0.045)
        ]
        self._axes = axes
        for part in self._parts:
            axes.add_patch(part)

    @override
    def move(self, moment: Moment) -> None:
        x = float(moment.observation[0])
        slope = np.arctan(1.35 * np.cos(3.0 * x))
        at = Affine2D().rotate(slope).translate(x, _height(x)) + self._axes.transData
        for part in self._parts:
            part.set_transform(at)


def _height(x):
    return 0.45 * np.sin(3.0 * x) + 0.55
