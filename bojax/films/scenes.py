"""Scenes: environments drawn on matplotlib axes and updated from step to step; lengths are in metres."""

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse, Polygon, Rectangle, Wedge
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray
from typing_extensions import override

from bojax.envs import lander_geometry as geometry
from bojax.envs import settings
from bojax.films.rendering import Renderer
from bojax.report.statistics import Floats
from bojax.results.store import ResultsError

if TYPE_CHECKING:
    from bojax.robots.models import RobotModel

GROUND, METAL, PALE, GOAL, TRAIL, RED = "#555555", "#4A5A68", "#8296A6", "#CDE8DB", "#B9C6D0", "#D55E00"
"""Colours of fixed parts, moving parts (two), the goal, trails, and flags and ends."""

TRAIL_STEPS = 60


class Scene(abc.ABC):
    """A drawing that is created once on its own axes and then updated."""

    # Whether it shows past positions and so has to be updated at every step, even at steps without an image
    has_trail: ClassVar[bool] = True
    # Duration of a step in seconds if the environment has no such setting; 0 if steps have no duration
    time_step: ClassVar[float] = 0.0

    @abc.abstractmethod
    def __init__(self, axes: Axes, env: Any): ...

    @abc.abstractmethod
    def move(self, observation: Floats, action: Floats, frame: Floats) -> None:
        """Show a step: the observation `[D]` before it, the action `[A]`, and what `Env.frame` recorded."""

    def close(self) -> None:  # noqa: B027
        """Release the resources of the drawing."""


class Replay(Protocol):
    """A recorded episode that is stepped again, in an environment that draws pictures itself."""

    seconds: float  # duration of a step; 0 if unknown

    @property
    def observation(self) -> Any:
        """Observation before the next step, `[D]` or an integer."""

    def begin(self) -> None:
        """Go to the start of the episode."""

    def picture(self) -> NDArray[np.uint8]:
        """What the environment draws, `[height, width, 3]`."""
        ...

    def step(self, action: Floats) -> None:
        """Take an action, `[A]`."""

    def close(self) -> None:
        """Close the environment."""


class ReplayScene(Scene):
    """The pictures that an environment draws itself while a recorded episode is stepped again."""

    def __init__(self, axes: Axes, env: Replay):
        self._replay, self._axes, self._image = env, axes, None
        axes.set_axis_off()
        env.begin()

    @override
    def move(self, observation: Floats, action: Floats, frame: Floats) -> None:
        if not np.allclose(np.ravel(self._replay.observation), observation, rtol=1e-4, atol=1e-4):
            raise ResultsError(
                "the environment does not repeat the recorded episode from its seed and actions, so that it "
                "cannot be drawn"
            )
        picture = self._replay.picture()
        if self._image is None:
            self._image = self._axes.imshow(picture, interpolation="antialiased")
        else:
            self._image.set_data(picture)
        self._replay.step(action)

    @override
    def close(self) -> None:
        self._replay.close()


class SinglePendulum(Scene):
    """A rod about the origin; observations are cosine and sine of the angle, to the left of upright."""

    def __init__(self, axes: Axes, env: settings.SinglePendulum):
        self._length = env.length
        reach = 1.15 * self._length
        _stage(axes, (-reach, reach), (-reach, reach))
        half = np.degrees(env.goal_angle)
        axes.add_patch(Wedge((0.0, 0.0), reach, 90.0 - half, 90.0 + half, color=GOAL, zorder=0))
        self._trail, self._rod = _Trail(axes), _rod(axes, METAL)
        _joint(axes)

    @override
    def move(self, observation: Floats, action: Floats, frame: Floats) -> None:
        x, y = -self._length * observation[1], self._length * observation[0]
        self._trail.add(x, y)
        self._rod.set_data([0.0, x], [0.0, y])


class DoublePendulum(Scene):
    """Two rods of 1 m; observations are cosine and sine of both angles.

    The first angle is measured from hanging down, the second from the first rod.
    """

    def __init__(self, axes: Axes, env: settings.DoublePendulum):
        top, depth = 2.0, env.goal_distance
        edge = 1.1 * top
        _stage(axes, (-edge, edge), (-edge, edge))
        if env.goal == "distance":
            goal = Circle((0.0, top), depth, color=GOAL, zorder=0)
        else:
            goal = Rectangle((-edge, top - depth), 2.0 * edge, depth + edge, color=GOAL, zorder=0)
        axes.add_patch(goal)
        self._trail = _Trail(axes)
        self._first, self._second = _rod(axes, METAL), _rod(axes, PALE)
        _joint(axes)
        self._elbow = _joint(axes)

    @override
    def move(self, observation: Floats, action: Floats, frame: Floats) -> None:
        cos1, sin1, cos2, sin2 = observation[:4]
        x, y = sin1, -cos1
        tip_x, tip_y = x + sin1 * cos2 + cos1 * sin2, y - (cos1 * cos2 - sin1 * sin2)
        self._trail.add(tip_x, tip_y)
        self._first.set_data([0.0, x], [0.0, y])
        self._second.set_data([x, tip_x], [y, tip_y])
        self._elbow.set_data([x], [y])


class CartpoleSwingUp(Scene):
    """A pole of 1 m on a cart; observations are position, velocity and angle, to the right of upright.

    The track ends where it is red.
    """

    def __init__(self, axes: Axes, env: settings.CartpoleSwingUp):
        limit = env.limit
        edge = limit + 0.6
        _stage(axes, (-edge, edge), (-1.3, 1.3))
        axes.plot([-limit, limit], [0.0, 0.0], color=GROUND, linewidth=1.6, zorder=1)
        for side in (-1.0, 1.0):
            axes.plot([side * limit, side * edge], [0.0, 0.0], color=RED, linewidth=1.6, zorder=1)
            axes.plot([side * limit] * 2, [-0.12, 0.12], color=RED, linewidth=2.2, zorder=1)
        half = np.degrees(np.arccos(env.goal_cosine))
        self._goal = Wedge((0.0, 0.0), 1.15, 90.0 - half, 90.0 + half, color=GOAL, zorder=0)
        self._cart = Rectangle((0.0, -0.13), 0.56, 0.26, facecolor=PALE, edgecolor=METAL, zorder=2)
        axes.add_patch(self._goal)
        axes.add_patch(self._cart)
        self._trail, self._pole, self._hinge = _Trail(axes), _rod(axes, METAL, 7.0), _joint(axes, 5.0)

    @override
    def move(self, observation: Floats, action: Floats, frame: Floats) -> None:
        x, angle = float(observation[0]), float(observation[2])
        tip_x, tip_y = x + np.sin(angle), np.cos(angle)
        self._trail.add(tip_x, tip_y)
        self._goal.set_center((x, 0.0))
        self._cart.set_x(x - 0.28)
        self._pole.set_data([x, tip_x], [0.0, tip_y])
        self._hinge.set_data([x], [0.0])


class MountainCar(Scene):
    """A hill of height sin(3 x), as Gym draws it, with a flag at the goal; the position is observed first."""

    def __init__(self, axes: Axes, env: settings.MountainCar):
        left, right = -1.2, 0.68
        _stage(axes, (left - 0.08, right), (-0.12, 1.24))
        x = np.linspace(left, right, 200)
        axes.fill_between(x, -0.12, self._height(x), color="#EDEDED", zorder=0)
        axes.plot(x, self._height(x), color=GROUND, linewidth=1.6, zorder=2)
        axes.plot([left, left], [-0.12, 1.2], color=GROUND, linewidth=3.0, zorder=2)  # the wall
        goal = env.goal_position
        beyond = np.linspace(goal, right, 50)
        axes.fill_between(beyond, -0.12, self._height(beyond), color=GOAL, zorder=1)
        foot = self._height(goal)
        axes.plot([goal, goal], [foot, foot + 0.18], color=GROUND, linewidth=1.5, zorder=2)
        flag = [(goal, foot + 0.18), (goal, foot + 0.10), (goal - 0.10, foot + 0.14)]
        axes.add_patch(Polygon(flag, color=RED, zorder=2))
        front, back = [(0.075, 0.025), (0.075, 0.06), (0.035, 0.095)], [(-0.045, 0.095), (-0.075, 0.06)]
        wheel: dict[str, Any] = {"facecolor": "white", "edgecolor": "#222222", "zorder": 5}
        self._parts = [Polygon([(-0.075, 0.025), *front, *back], color=METAL, zorder=4)]
        self._parts += [Circle((x, 0.025), 0.024, **wheel) for x in (-0.045, 0.045)]
        self._axes = axes
        for part in self._parts:
            axes.add_patch(part)

    @override
    def move(self, observation: Floats, action: Floats, frame: Floats) -> None:
        x = float(observation[0])
        slope = np.arctan(1.35 * np.cos(3.0 * x))
        at = Affine2D().rotate(slope).translate(x, self._height(x)) + self._axes.transData
        for part in self._parts:
            part.set_transform(at)

    @staticmethod
    def _height(x):
        return 0.45 * np.sin(3.0 * x) + 0.55


class LunarLander(Scene):
    """The hull on its legs, with flames of the engines that are on; the goal is one for its centre.

    Observations are the position relative to the pad, velocity and tilt, as in Gym.
    """

    time_step = geometry.TIME_STEP

    def __init__(self, axes: Axes, env: settings.LunarLander):
        _stage(axes, (-0.3, geometry.WIDTH + 0.3), (0.0, 1.12 * geometry.HEIGHT))
        across, up = (2.0 * env.goal_distance * unit for unit in geometry.UNITS)
        axes.add_patch(Ellipse(geometry.ORIGIN, across, up, color=GOAL, zorder=2))
        self._across = np.linspace(0.0, geometry.WIDTH, geometry.NUM_HEIGHTS)
        self._moon = _polygon(axes, "#ECEFF1", GROUND, zorder=0)
        pad = self._across[list(geometry.PAD)]
        axes.plot(pad, np.full(len(pad), geometry.PAD_HEIGHT), color="#009E73", linewidth=3.0, zorder=1)
        self._trail = _Trail(axes)
        self._flames = [_polygon(axes, "#E69F00", "none", zorder=3) for _ in range(3)]
        self._legs = [_polygon(axes, "white", METAL, zorder=4) for _ in range(2)]
        self._hull = _polygon(axes, PALE, METAL, zorder=5)

    @override
    def move(self, observation: Floats, action: Floats, frame: Floats) -> None:
        origin = np.asarray(geometry.ORIGIN) + observation[:2] * geometry.UNITS
        angle = float(observation[4])
        legs, terrain = frame[:2], frame[2:]
        self._trail.add(*origin.tolist())
        ground = np.stack([self._across, terrain], axis=1)
        self._moon.set_xy(np.concatenate([ground, [[geometry.WIDTH, -1.0], [0.0, -1.0]]]))
        self._hull.set_xy(origin + geometry.rotated(geometry.HULL, angle))
        for leg, side, opened in zip(self._legs, (1.0, -1.0), legs, strict=True):
            at_rest = geometry.rotated(geometry.LEG_CENTRE + geometry.LEG, opened + geometry.LEG_FOLDED)
            leg.set_xy(origin + geometry.rotated(at_rest * [side, 1.0], angle))
        for flame, shape in zip(self._flames, _flames(*action.tolist()), strict=True):
            flame.set_xy(origin + geometry.rotated(shape, angle))


class RobotScene(Scene):
    """A robot in its world, rendered by MuJoCo: an image that fills the axes and is updated by frames."""

    has_trail = False

    def __init__(self, axes: Axes, env: "RobotModel"):
        axes.set_axis_off()
        box = axes.get_window_extent()
        width, height = round(box.width), round(box.height)
        self._renderer = Renderer(env, width, height)
        blank = np.full((height, width, 3), 255, np.uint8)
        self._picture = axes.imshow(blank, aspect="auto", interpolation="nearest")

    @override
    def move(self, observation: Floats, action: Floats, frame: Floats) -> None:
        self.show(frame)

    def show(self, frame: Floats) -> None:
        """Show a frame, as `Renderer.image` takes it."""
        try:
            self._picture.set_data(self._renderer.image(frame))
        except ValueError as error:
            raise ResultsError(f"the model differs from the one that was simulated: {error}") from error

    @override
    def close(self) -> None:
        self._renderer.close()


def _flames(main: float, side: float) -> list[Floats]:
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


def _stage(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Give axes equal scales, these ranges and no frame."""
    axes.set_xlim(*x)
    axes.set_ylim(*y)
    axes.set_aspect("equal")
    axes.set_axis_off()


class _Trail:
    """The path of a point over the last steps."""

    def __init__(self, axes: Axes):
        (self._line,) = axes.plot([], [], color=TRAIL, linewidth=1.2, zorder=1)
        self._points: list[tuple[float, float]] = []

    def add(self, x: float, y: float) -> None:
        """Append the present position of the point."""
        self._points = [*self._points, (x, y)][-TRAIL_STEPS:]
        self._line.set_data(*np.transpose(self._points))


def _rod(axes: Axes, colour: str, width: float = 9.0) -> Line2D:
    """A rigid link; `set_data` sets its ends."""
    (line,) = axes.plot([], [], color=colour, linewidth=width, solid_capstyle="round", zorder=3)
    return line


def _joint(axes: Axes, size: float = 6.0) -> Line2D:
    """A hinge; `set_data` sets its position."""
    (dot,) = axes.plot([0.0], [0.0], "o", ms=size, mfc="white", mec="#222222", mew=1.2, zorder=4)
    return dot


def _polygon(axes: Axes, colour: str, edge: str, zorder: int) -> Polygon:
    """A polygon; `set_xy` sets its corners."""
    patch = Polygon(np.zeros((3, 2)), facecolor=colour, edgecolor=edge, linewidth=1.2, zorder=zorder)
    axes.add_patch(patch)
    return patch


SCENES: Mapping[str, type[Scene]] = {
    "single-pendulum": SinglePendulum,
    "mountain-car": MountainCar,
    "double-pendulum": DoublePendulum,
    "cartpole-swing-up": CartpoleSwingUp,
    "lunar-lander": LunarLander,
}
"""The scene of every environment that can be drawn, by identifier."""
