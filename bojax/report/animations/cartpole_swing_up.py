"""The cart and its pole; observations are position and velocity, angle from upright and its velocity."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle, Wedge
from typing_extensions import override

from bojax.envs import settings
from bojax.report.animations.base import (
    GOAL,
    GROUND,
    METAL,
    Moment,
    Scene,
    Trail,
    joint,
    rod,
    stage,
)

_LENGTH = 1.0


class CartpoleSwingUp(Scene):
    """A pole of 1 m on a cart; positive angles lean to the right. The track ends where it is red."""

    def __init__(self, axes: Axes, env: settings.CartpoleSwingUp):
        limit = env.limit
        edge = limit + 0.6
        stage(axes, (-edge, edge), (-1.3, 1.3))
        axes.plot([-limit, limit], [0.0, 0.0], color=GROUND, linewidth=1.6, zorder=1)
        for side in (-1.0, 1.0):
            end = [side * limit, side * edge]
            axes.plot(end, [0.0, 0.0], color="#D55E00", linewidth=1.6, zorder=1)
            axes.plot([side * limit] * 2, [-0.12, 0.12], color="#D55E00", linewidth=2.2, zorder=1)
        half = np.degrees(np.arccos(env.goal_cosine))
        self._goal = Wedge((0.0, 0.0), 1.15 * _LENGTH, 90.0 - half, 90.0 + half, color=GOAL, zorder=0)
        self._cart = Rectangle((0.0, -0.13), 0.56, 0.26, facecolor="#8296A6", edgecolor=METAL, zorder=2)
        axes.add_patch(self._goal)
        axes.add_patch(self._cart)
        self._trail, self._pole, self._hinge = Trail(axes), rod(axes, METAL, 7.0), joint(axes, 5.0)

    @override
    def move(self, moment: Moment) -> None:
        x, angle = float(moment.observation[0]), float(moment.observation[2])
        tip_x, tip_y = x + _LENGTH * np.sin(angle), _LENGTH * np.cos(angle)
        self._trail.add(tip_x, tip_y)
        self._goal.set_center((x, 0.0))
        self._cart.set_x(x - 0.28)
        self._pole.set_data([x, tip_x], [0.0, tip_y])
        self._hinge.set_data([x], [0.0])
