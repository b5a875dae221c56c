"""The MuJoCo model of the wheeled robot, and the parameters that its controller reads from it."""

from dataclasses import dataclass
from math import tan

from bojax.robots.models import MjModel, RobotModel, packaged


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
