"""MuJoCo models of robots in their worlds, for films."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from bojax.results.outline import Outline
from bojax.results.store import ResultsError
from bojax.robots.models import RobotModel, from_file, jaco_model, mujoco, packaged

Heights = NDArray[np.float64]
"""Heights in metres on a regular grid over the domain; the first axis is y, the second x, both increasing."""

WALL_HEIGHT = 0.1  # height of walls above the highest ground, in metres; no problem has a setting for it

_DEFAULT_DOMAIN = (-5.0, -5.0, 5.0, 5.0)
_GROUND_POINTS = 81  # least number of points a side, so that hills look smooth
_BASE = 0.05  # thickness of a height field below its lowest point, in metres
_MATERIAL_COLOUR = [0.5, 0.5, 0.5, 1.0]  # MuJoCo's default: the colour of the material is shown
_WALL, _PARKING_SPOT = [0.4, 0.42, 0.45, 1.0], [0.36, 0.62, 0.45, 1.0]


def car_world(outline: Outline) -> RobotModel:
    """The wheeled robot on a floor that covers the domain, with obstacles and goals, whatever the ground.

    The camera `side` follows the robot, which is small compared with most domains.
    """
    spec = packaged("car").spec()
    middle, half = _centred(outline.border or _DEFAULT_DOMAIN)
    floor = spec.geom("floor")
    floor.pos, floor.size = [*middle, 0.0], [*half, 0.1]
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

    Blocks are boxes on a floor. Other fields are height fields, given by their recorded true values; without
    a field there is a floor. The camera `overview` sees the whole domain.
    """
    spec = packaged("quadrotor").spec()
    middle, half = _centred(outline.border or _DEFAULT_DOMAIN)
    radius = float(np.max(half))
    if ground is None or len(outline.blocks) > 0:
        look = {"material": "floor", "rgba": _MATERIAL_COLOUR}
        _add(spec, "PLANE", [*middle, 0.0], [*half, 0.1], name="floor", **look)
        lowest, highest = 0.0, max([0.0, *(float(block[4]) for block in outline.blocks)])
    else:
        lowest, highest = float(np.min(ground)), float(np.max(ground))
        _add_height_field(spec, ground, middle, half)
    for *box, height in outline.blocks:
        _add_box(spec, box, 0.0, float(height), material="prop", rgba=_MATERIAL_COLOUR)
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
    "wheeled-robot": lambda outline, ground: car_world(outline),
    "quadrotor": quadrotor_world,
}
"""Function from the outline of a problem and the true values of its field to a model, by kind of vehicle."""


def _centred(box: Sequence[Any]) -> tuple[list[float], list[float]]:
    """The middle of a box `(x_min, y_min, x_max, y_max)` and half its sides."""
    low, high = np.asarray(box, np.float64).reshape(2, 2)
    return (0.5 * (low + high)).tolist(), (0.5 * (high - low)).tolist()


def _add(spec: Any, kind: str, pos: Sequence[Any], size: Sequence[Any], **options: Any) -> None:
    """Add a geom of a kind of `mjtGeom` without contacts."""
    kind = getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")
    spec.worldbody.add_geom(type=kind, pos=pos, size=size, contype=0, conaffinity=0, **options)


def _add_box(spec: Any, box: Sequence[Any], low: float, high: float, **options: Any) -> None:
    """Add a box between two heights."""
    middle, half = _centred(box)
    _add(spec, "BOX", [*middle, 0.5 * (low + high)], [*half, 0.5 * (high - low)], **options)


def _add_height_field(spec: Any, ground: Heights, middle: list[float], half: list[float]) -> None:
    """Add heights, refined by bicubic splines so that they look smooth."""
    y, x = (np.linspace(0.0, 1.0, size) for size in ground.shape)
    fine_y, fine_x = (np.linspace(0.0, 1.0, max(size, _GROUND_POINTS)) for size in ground.shape)
    spline = RectBivariateSpline(y, x, ground, kx=min(3, len(y) - 1), ky=min(3, len(x) - 1))
    ground = spline(fine_y, fine_x)
    bottom = float(np.min(ground))
    rise = max(float(np.max(ground)) - bottom, 1e-6)
    heights = ((ground - bottom) / rise).ravel().tolist()
    rows, columns = ground.shape
    spec.add_hfield(name="ground", size=[*half, rise, _BASE], nrow=rows, ncol=columns, userdata=heights)
    look = {"material": "ground", "rgba": _MATERIAL_COLOUR}
    _add(spec, "HFIELD", [*middle, bottom], [0.0] * 3, name="ground", hfieldname="ground", **look)


def _add_surroundings(spec: Any, outline: Outline, lowest: float = 0.0, highest: float = 0.0) -> None:
    """Add obstacles as walls, and discs to reach as parking spots with a bar along the goal heading.

    The ground is between the lowest and the highest of these heights, in metres.
    """
    top = highest + WALL_HEIGHT
    for shape in outline.obstacles:
        if len(shape) == 3:
            x, y, radius = shape
            size = [radius, 0.5 * (top - lowest), 0.0]
            _add(spec, "CYLINDER", [x, y, 0.5 * (lowest + top)], size, rgba=_WALL)
        else:
            _add_box(spec, shape, lowest, top, rgba=_WALL)
    for number, (x, y, radius) in enumerate(shape for shape in outline.goals if len(shape) == 3):
        spot = {"name": f"goal_{number}", "rgba": _PARKING_SPOT}
        _add(spec, "CYLINDER", [x, y, 0.0], [radius, 0.0005, 0.0], **spot)
        if outline.heading is not None:
            cos, sin = math.cos(outline.heading), math.sin(outline.heading)
            turn = [math.cos(0.5 * outline.heading), 0.0, 0.0, math.sin(0.5 * outline.heading)]
            spot["name"] += "_heading"
            centre = [x + 1.73 * radius * cos, y + 1.73 * radius * sin, 0.0]
            _add(spec, "BOX", centre, [0.75 * radius, 0.15 * radius, 0.0005], quat=turn, **spot)


def compiled(path: Path | None, make: Callable[[], RobotModel]) -> RobotModel:
    """The model of an MJCF file, or else the one that a function makes; compiled once."""
    try:
        model = make() if path is None else from_file(path)
        model.compiled()
    except ValueError as error:
        raise ResultsError(str(error)) from error
    return model


def is_free(model: RobotModel) -> bool:
    """Whether the first joint is free: generalised positions begin with a position and a quaternion."""
    return model.compiled().nq >= 7 and model.compiled().jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
