"""MuJoCo models of the robots in films and of their worlds, made from the settings in a manifest."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from bojax.report.animations.base import Settings
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


def car_world(problem: Settings, ground: Heights | None = None) -> RobotModel:
    """The wheeled robot on a floor that covers the domain, with walls and the spot of a parking task.

    The camera `side` follows the robot, which is small compared with most domains.

    Args:
        problem: Settings of the problem.
        ground: Ignored: the robot drives on a plane.
    """
    del ground
    spec = car_model().spec()
    x_min, y_min, x_max, y_max = domain_of(problem)
    floor = spec.geom("floor")
    floor.pos = [0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.0]
    floor.size = [0.5 * (x_max - x_min), 0.5 * (y_max - y_min), 0.1]
    spec.body("chassis").add_camera(
        name="side",
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        pos=[0.05, -1.02, 1.36],
        xyaxes=[1.0, 0.0, 0.0, 0.0, 0.8, 0.6],
    )
    _add_surroundings(spec, problem)
    return RobotModel(spec.to_xml())


def quadrotor_world(problem: Settings, ground: Heights | None = None) -> RobotModel:
    """The quadrotor above the ground of its problem, with walls and the spot of a parking task.

    Blocks are drawn as boxes on a floor, every other field as a height field; without a field there is a
    floor. The camera `overview` sees the whole domain.

    Args:
        problem: Settings of the problem.
        ground: True values of the problem's field, as recorded with the run.
    """
    spec = quadrotor_model().spec()
    field = problem.get("field") or {}
    blocks = np.zeros((0, 5))
    if field.get("kind") == "blocks":
        blocks = np.column_stack([field["boxes"], field["heights"]])
    domain = np.asarray(domain_of(problem))
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
    _add_surroundings(spec, problem, min(0.0, lowest), highest)
    return RobotModel(spec.to_xml())


ENVS: Mapping[str, Callable[[Settings], RobotModel]] = {
    "hopper": lambda env: packaged("hopper"),
    "reacher": lambda env: packaged("reacher"),
    "jaco": lambda env: jaco_model(env["joints"]),
}
"""Model of a robot environment from its settings, by kind."""

VEHICLES: Mapping[str, Callable[[Settings, Heights | None], RobotModel]] = {
    "wheeled-robot": car_world,
    "quadrotor": quadrotor_world,
}
"""Model of a vehicle from the settings of its problem and the recorded values of the field, by kind."""


def domain_of(problem: Settings) -> tuple[float, float, float, float]:
    """Border of a domain, `(x_min, y_min, x_max, y_max)` in metres; 10 x 10 m without such settings."""
    if "half_width" in problem:
        half = float(problem["half_width"])
        return -half, -half, half, half
    x_min, y_min, x_max, y_max = problem.get("domain", _DEFAULT_DOMAIN)
    return float(x_min), float(y_min), float(x_max), float(y_max)


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


def _add_surroundings(spec: Any, problem: Settings, lowest: float = 0.0, highest: float = 0.0) -> None:
    """Add the walls of a problem, and the parking spot of a parking task, without contacts.

    Args:
        spec: Editable model of the world.
        problem: Settings of the problem.
        lowest: Height of the lowest ground, in metres.
        highest: Height of the highest ground, in metres.
    """
    middle, half = 0.5 * (lowest + highest + WALL_HEIGHT), 0.5 * (highest + WALL_HEIGHT - lowest)
    for x_min, y_min, x_max, y_max in problem.get("walls") or ():
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[0.5 * (x_min + x_max), 0.5 * (y_min + y_max), middle],
            size=[0.5 * (x_max - x_min), 0.5 * (y_max - y_min), half],
            rgba=_WALL,
            **_NO_CONTACT,
        )
    if "half_width" in problem:
        _add_parking_spot(spec, float(problem["distance_tolerance"]))


def _add_parking_spot(spec: Any, radius: float) -> None:
    """A disc on the floor at the goal position, and a bar along the goal heading."""
    disc, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    shown = {"rgba": _PARKING_SPOT, **_NO_CONTACT}
    spec.worldbody.add_geom(name="parking_spot", type=disc, size=[radius, 0.0005, 0.0], **shown)
    bar = {"size": [0.75 * radius, 0.15 * radius, 0.0005], "pos": [1.73 * radius, 0.0, 0.0]}
    spec.worldbody.add_geom(name="parking_heading", type=box, **bar, **shown)
