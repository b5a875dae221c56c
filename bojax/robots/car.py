"""The model of the wheeled robot, its measures, and the place where it parks, to be drawn."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import tan
from typing import Any

from bojax.robots.models import MjModel, RobotModel, mujoco, packaged
from bojax.robots.surroundings import domain_of, furnish


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
    """The robot on a floor as large as the domain, with its walls, and the lot if it has to park.

    A camera named `side` goes along with the robot, which is small beside most domains.

    Args:
        problem: The settings of the problem, from a manifest.
    """
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
    furnish(spec, problem)
    return RobotModel(spec.to_xml())
