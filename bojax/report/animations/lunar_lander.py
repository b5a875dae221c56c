"""The lander above the moon; observations are position relative to the pad, velocity and tilt, as in Gym."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Polygon
from numpy.typing import NDArray
from typing_extensions import override

from bojax.envs import lander_geometry as geometry
from bojax.envs import settings
from bojax.report.animations.base import GOAL, GROUND, METAL, Moment, Scene, Trail, stage

_HULL, _MOON, _FLAME = "#8296A6", "#ECEFF1", "#E69F00"


class LunarLander(Scene):
    """The hull on its legs, with flames of the engines that are on; the goal is one for its centre."""

    time_step = geometry.TIME_STEP

    def __init__(self, axes: Axes, env: settings.LunarLander):
        stage(axes, (-0.3, geometry.WIDTH + 0.3), (0.0, 1.12 * geometry.HEIGHT))
        across, up = (2.0 * env.goal_distance * unit for unit in geometry.UNITS)
        axes.add_patch(Ellipse(geometry.ORIGIN, across, up, color=GOAL, zorder=2))
        self._across = np.linspace(0.0, geometry.WIDTH, geometry.NUM_HEIGHTS)
        self._moon = _patch(axes, _MOON, GROUND, zorder=0)
        pad = self._across[list(geometry.PAD)]
        axes.plot(pad, np.full(len(pad), geometry.PAD_HEIGHT), color="#009E73", linewidth=3.0, zorder=1)
        self._trail = Trail(axes)
        self._flames = [_patch(axes, _FLAME, "none", zorder=3) for _ in range(3)]
        self._legs = [_patch(axes, "white", METAL, zorder=4) for _ in range(2)]
        self._hull = _patch(axes, _HULL, METAL, zorder=5)

    @override
    def move(self, moment: Moment) -> None:
        origin = np.asarray(geometry.ORIGIN) + moment.observation[:2] * geometry.UNITS
        angle = float(moment.observation[4])
        legs, terrain = moment.frame[:2], moment.frame[2:]
        self._trail.add(*origin.tolist())
        ground = np.stack([self._across, terrain], axis=1)
        self._moon.set_xy(np.concatenate([ground, [[geometry.WIDTH, -1.0], [0.0, -1.0]]]))
        self._hull.set_xy(origin + geometry.rotated(geometry.HULL, angle))
        for leg, side, opened in zip(self._legs, (1.0, -1.0), legs, strict=True):
            at_rest = geometry.rotated(geometry.LEG_CENTRE + geometry.LEG, opened + geometry.LEG_FOLDED)
            leg.set_xy(origin + geometry.rotated(at_rest * [side, 1.0], angle))
        for flame, shape in zip(self._flames, _flames(*moment.action.tolist()), strict=True):
            flame.set_xy(origin + geometry.rotated(shape, angle))


def _flames(main: float, side: float) -> list[NDArray[np.float64]]:
    """Triangles below, left and right of the hull, with lengths proportional to the power of the engines."""
    below = 0.5 * (1.0 + main) if main > 0.0 else 0.0
    left, right = (max(0.0, power) if abs(side) > 0.5 else 0.0 for power in (side, -side))
    bottom, height = geometry.HULL[:, 1].min(), geometry.SIDE_ENGINE[2]
    triangle = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0]])
    return [
        triangle * [0.25 * bool(below), 1.3 * below] + [0.0, bottom],
        *(
            triangle[:, ::-1] * [sign * 0.9 * power, 0.12 * bool(power)]
            + [-sign * geometry.SIDE_ENGINE[0], height]
            for sign, power in ((1.0, left), (-1.0, right))
        ),
    ]


def _patch(axes: Axes, colour: str, edge: str, zorder: int) -> Polygon:
    """A polygon; `set_xy` sets its corners."""
    patch = Polygon(np.zeros((3, 2)), facecolor=colour, edgecolor=edge, linewidth=1.2, zorder=zorder)
    axes.add_patch(patch)
    return patch
