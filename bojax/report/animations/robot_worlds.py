"""MuJoCo models of robots in their worlds, for films."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from bojax.results.outline import Outline
from bojax.robots.car import car_model
from bojax.robots.jaco import jaco_model
from bojax.robots.models import RobotModel, mujoco, packaged
from bojax.robots.quadrotor import quadrotor_model

Heights = NDArray[np.float64]
"""Heights in metres on a regular grid over the domain; the first axis is y, the second x, both increasing."""

WALL_HEIGHT = 0.1
"""Height of walls above the highest ground, in metres; no problem has a setting for it."""

_DEFAULT_DOMAIN = (-5.0, -5.0, 5.0, 5.0)
_GROUND_POINTS = 81  # least number of points a side, so that hills look smooth
_BASE = 0.05  # thickness of a height field below its lowest point, in metres
_NO_CONTACT = {"contype": 0, "conaffinity": 0}
_MATERIAL_COLOUR = [0.5, 0.5, 0.5, 1.0]  # MuJoCo's default: the colour of the material is shown
_WALL, _PARKING_SPOT = [0.4, 0.42, 0.45, 1.0], [0.36, 0.62, 0.45, 1.0]


def car_world(outline: Outline, ground: Heights | None = None) -> RobotModel:
    """The wheeled robot on a floor that covers the domain, with obstacles and goals.

    The camera `side` follows the robot, which is small compared with most domains.

    Args:
        outline: The world of the problem.
        ground: Ignored: the robot drives on a plane.
    """
    del ground
    spec = car_model().spec()
    x_min, y_min, x_max, y_max = outline.border or _DEFAULT_DOMAIN
    floor = spec.geom("floor")
    floor.pos = [0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.0]
    floor.size = [0.5 * (x_max - x_min), 0.5 * (y_max - y_min), 0.1]
    spec.body("chassis").add_camera(
        name="side",
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        pos=[0.05, -1.02, 1.36],
        xyaxes=[1.0, 0.0, 0.0, 0.0, 0.8, 0.6],
    )
    _add_surroundings(spec, outline)
    return RobotModel(spec.to_xml())


def quadrotor_world(outline: Outline, ground: Heights | None = None) -> RobotModel:
    """The quadrotor above the ground of its problem, with obstacles and goals.

    Blocks are boxes on a floor, other fields are height fields; without a field there is a floor. The camera
    `overview` sees the whole domain.

    Args:
        outline: The world of the problem.
        ground: True values of the problem's field, as recorded with the run.
    """
    spec = quadrotor_model().spec()
    blocks = np.asarray(outline.blocks, np.float64).reshape(-1, 5)
    domain = np.asarray(outline.border or _DEFAULT_DOMAIN, np.float64)
    middle, half = 0.5 * (domain[:2] + domain[2:]), 0.5 * (domain[2:] - domain[:2])
    radius = float(np.max(half))
    if ground is None or len(blocks) > 0:
        spec.worldbody.add_geom(
            name="floor",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            pos=[*middle, 0.0],
            size=[*half, 0.1],
            material="floor",
            rgba=_MATERIAL_COLOUR,
            **_NO_CONTACT,
        )
        lowest, highest = 0.0, float(np.max(blocks[:, 4], initial=0.0))
    else:
        lowest, highest = float(np.min(ground)), float(np.max(ground))
        _add_height_field(spec, ground, middle, half)
    for x_min, y_min, x_max, y_max, height in blocks:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.5 * height],
            size=[0.5 * (x_max - x_min), 0.5 * (y_max - y_min), 0.5 * height],
            material="prop",
            rgba=_MATERIAL_COLOUR,
            **_NO_CONTACT,
        )
    spec.stat.extent = 2.0 * radius  # bounds the distance up to which shadows are cast
    spec.worldbody.add_camera(
        name="overview",
        pos=[middle[0], middle[1] - 2.6 * radius, 2.4 * radius],
        xyaxes=[1.0, 0.0, 0.0, 0.0, 0.68, 0.73],
    )
    _add_surroundings(spec, outline, min(0.0, lowest), highest)
    return RobotModel(spec.to_xml())


ENVS: Mapping[str, Callable[[Any], RobotModel]] = {
    "hopper": lambda env: packaged("hopper"),
    "reacher": lambda env: packaged("reacher"),
    "jaco": lambda env: jaco_model(env.joints),
}
"""Function from the settings of a robot environment to its model, by kind."""

VEHICLES: Mapping[str, Callable[[Outline, Heights | None], RobotModel]] = {
    "wheeled-robot": car_world,
    "quadrotor": quadrotor_world,
}
"""Function from the outline of a problem and the true values of its field to a model, by kind of vehicle."""


def _add_height_field(spec: Any, ground: Heights, middle: NDArray, half: NDArray) -> None:
    ground = _refined(ground)
    bottom = float(np.min(ground))
    rise = max(float(np.max(ground)) - bottom, 1e-6)
    spec.add_hfield(
        name="ground",
        size=[*half, rise, _BASE],
        nrow=ground.shape[0],
        ncol=ground.shape[1],
        userdata=((ground - bottom) / rise).ravel().tolist(),
    )
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="ground",
        pos=[*middle, bottom],
        material="ground",
        rgba=_MATERIAL_COLOUR,
        **_NO_CONTACT,
    )


def _refined(ground: Heights) -> Heights:
    """Heights on a grid fine enough to look smooth, by bicubic splines."""
    y, x = (np.linspace(0.0, 1.0, size) for size in ground.shape)
    fine_y, fine_x = (np.linspace(0.0, 1.0, max(size, _GROUND_POINTS)) for size in ground.shape)
    spline = RectBivariateSpline(y, x, ground, kx=min(3, len(y) - 1), ky=min(3, len(x) - 1))
    return spline(fine_y, fine_x)


def _add_surroundings(spec: Any, outline: Outline, lowest: float = 0.0, highest: float = 0.0) -> None:
    """Add obstacles and goals without contacts: obstacles as walls, goals as discs on the floor.

    Args:
        spec: Editable model of the world.
        outline: The world of the problem.
        lowest: Height of the lowest ground, in metres.
        highest: Height of the highest ground, in metres.
    """
    box, disc = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    middle, half = 0.5 * (lowest + highest + WALL_HEIGHT), 0.5 * (highest + WALL_HEIGHT - lowest)
    wall = {"rgba": _WALL, **_NO_CONTACT}
    for shape in outline.obstacles:
        if len(shape) == 3:
            spec.worldbody.add_geom(type=disc, pos=[*shape[:2], middle], size=[shape[2], half, 0.0], **wall)
        else:
            x_min, y_min, x_max, y_max = shape
            centre = [0.5 * (x_min + x_max), 0.5 * (y_min + y_max), middle]
            size = [0.5 * (x_max - x_min), 0.5 * (y_max - y_min), half]
            spec.worldbody.add_geom(type=box, pos=centre, size=size, **wall)
    for number, shape in enumerate(shape for shape in outline.goals if len(shape) == 3):
        _add_parking_spot(spec, f"goal_{number}", shape, outline.heading)


def _add_parking_spot(spec: Any, name: str, shape: Sequence[float], heading: float | None) -> None:
    """A disc on the floor, and a bar that points in the direction of the goal heading."""
    disc, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    shown = {"rgba": _PARKING_SPOT, **_NO_CONTACT}
    x, y, radius = shape
    spec.worldbody.add_geom(name=name, type=disc, pos=[x, y, 0.0], size=[radius, 0.0005, 0.0], **shown)
    if heading is None:
        return
    centre = [x + 1.73 * radius * math.cos(heading), y + 1.73 * radius * math.sin(heading), 0.0]
    turn = [math.cos(0.5 * heading), 0.0, 0.0, math.sin(0.5 * heading)]
    size = [0.75 * radius, 0.15 * radius, 0.0005]
    spec.worldbody.add_geom(name=f"{name}_heading", type=box, pos=centre, quat=turn, size=size, **shown)
