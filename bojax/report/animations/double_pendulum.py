"""The two-link pendulum; observations are cosine and sine of both angles, and the velocities."""

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle
from typing_extensions import override

from bojax.envs import settings
from bojax.report.animations.base import GOAL, METAL, Moment, Scene, Trail, joint, rod, stage

_REACH = 2.0


class DoublePendulum(Scene):
    """Two rods of 1 m; the first angle is measured from hanging down, the second from the first rod."""

    def __init__(self, axes: Axes, env: settings.DoublePendulum):
        edge = 1.1 * _REACH
        stage(axes, (-edge, edge), (-edge, edge))
        depth = env.goal_distance
        if env.goal == "distance":
            goal = Circle((0.0, _REACH), depth, color=GOAL, zorder=0)
        else:
            goal = Rectangle((-edge, _REACH - depth), 2.0 * edge, depth + edge, color=GOAL, zorder=0)
        axes.add_patch(goal)
        self._trail = Trail(axes)
        self._first, self._second = rod(axes, METAL), rod(axes, "#8296A6")
        joint(axes)
        self._elbow = joint(axes)

    @override
    def move(self, moment: Moment) -> None:
        cos1, sin1, cos2, sin2 = moment.observation[:4]
        x, y = sin1, -cos1
        tip_x, tip_y = x + sin1 * cos2 + cos1 * sin2, y - (cos1 * cos2 - sin1 * sin2)
        self._trail.add(tip_x, tip_y)
        self._first.set_data([0.0, x], [0.0, y])
        self._second.set_data([x, tip_x], [y, tip_y])
        self._elbow.set_data([x], [y])
