"""The pendulum; observations are cosine and sine of the angle from upright, and the velocity."""

from math import degrees

from matplotlib.axes import Axes
from matplotlib.patches import Wedge
from typing_extensions import override

from bojax.envs import settings
from bojax.report.animations.base import GOAL, METAL, Moment, Scene, Trail, joint, rod, stage


class SinglePendulum(Scene):
    """A rod about the origin; positive angles lean to the left."""

    def __init__(self, axes: Axes, env: settings.SinglePendulum):
        self._length = env.length
        reach = 1.15 * self._length
        stage(axes, (-reach, reach), (-reach, reach))
        half = degrees(env.goal_angle)
        axes.add_patch(Wedge((0.0, 0.0), reach, 90.0 - half, 90.0 + half, color=GOAL, zorder=0))
        self._trail, self._rod = Trail(axes), rod(axes, METAL)
        joint(axes)

    @override
    def move(self, moment: Moment) -> None:
        x, y = -self._length * moment.observation[1], self._length * moment.observation[0]
        self._trail.add(x, y)
        self._rod.set_data([0.0, x], [0.0, y])
