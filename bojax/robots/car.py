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
    """The robot on a floor as large as the domain, with the lot, from a problem's settings in a manifest."""
    spec = car_model().spec()
    half_width, tolerance = float(problem["half_width"]), float(problem["distance_tolerance"])
    spec.geom("floor").size = [half_width, half_width, 0.1]
    lot = {"contype": 0, "conaffinity": 0, "rgba": [0.36, 0.62, 0.45, 1.0]}
    spec.worldbody.add_geom(
        name="lot", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[tolerance, 0.0005, 0.0], **lot
    )
    spec.worldbody.add_geom(
        name="lot_heading",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[tolerance, 0.15 * tolerance, 0.0005],
        pos=[1.5 * tolerance, 0.0, 0.0],
        **lot,
    )
    camera = spec.camera("overview")
    camera.pos = [position * half_width / 1.5 for position in camera.pos]
    return RobotModel(spec.to_xml())
