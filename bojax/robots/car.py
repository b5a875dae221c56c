"""The model of the wheeled robot, its measures, and the place where it parks, to be drawn."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import tan
from typing import Any

from bojax.robots.models import MjModel, RobotModel, mujoco, packaged


def car_model() -> RobotModel:
    """The robot alone, on a floor."""
    return packaged("car")


@dataclass(frozen=True)
class Measures:
    """What a controller knows of the robot.

    Attributes:
        wheelbase: Distance of the axles, in metres.
        half_track: Half the distance of the axes about which the front wheels are turned, in metres.
        max_angle: Largest angle of a front wheel, in radians.
        full_speed: Speed at the control 1, in m/s.
    """

    wheelbase: float
    half_track: float
    max_angle: float
    full_speed: float

    @property
    def turning_radius(self) -> float:
        """Radius of the tightest curve of the middle of the rear axle, in metres: the inner wheel's limit."""
        return self.wheelbase / tan(self.max_angle) + self.half_track


def measures_of(model: MjModel) -> Measures:
    """The measures of a compiled model of the robot."""
    wheelbase, half_track, _ = model.body("front_left").pos
    drive = model.actuator("drive")
    radius = model.geom("rear_left").size[0]
    return Measures(
        wheelbase=float(wheelbase),
        half_track=float(half_track),
        max_angle=float(model.actuator("steer_left").ctrlrange[1]),
        full_speed=float(radius * drive.gainprm[0] / -drive.biasprm[2]),
    )


def scene_of(problem: Mapping[str, Any]) -> RobotModel:
    """The robot on a floor as large as the domain, with the lot if it has to park.

    Args:
        problem: The settings of the problem, from a manifest.
    """
    spec = car_model().spec()
    is_parking = "half_width" in problem
    width = float(problem["half_width"]) if is_parking else 0.0
    bounds = (-width, -width, width, width) if is_parking else problem["domain"]
    x_min, y_min, x_max, y_max = (float(bound) for bound in bounds)
    middle, half = (
        (0.5 * (x_min + x_max), 0.5 * (y_min + y_max)),
        (0.5 * (x_max - x_min), 0.5 * (y_max - y_min)),
    )
    floor, camera = spec.geom("floor"), spec.camera("overview")
    floor.pos, floor.size = [*middle, 0.0], [*half, 0.1]
    camera.pos = [middle[0], middle[1] - 1.54 * max(half), 2.0 * max(half)]
    if is_parking:
        _add_lot(spec, float(problem["distance_tolerance"]))
    return RobotModel(spec.to_xml())


def _add_lot(spec: Any, radius: float) -> None:
    """A disc on the floor, and a line along the heading wanted there."""
    flat = {"contype": 0, "conaffinity": 0, "rgba": [0.36, 0.62, 0.45, 1.0]}
    disc, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(name="lot", type=disc, size=[radius, 0.0005, 0.0], **flat)
    line = {"size": [radius, 0.15 * radius, 0.0005], "pos": [1.5 * radius, 0.0, 0.0]}
    spec.worldbody.add_geom(name="lot_heading", type=box, **line, **flat)
