"""The parameters of the wheeled robot that its controller reads from its MuJoCo model."""

from dataclasses import dataclass
from math import tan

from bojax.robots.models import MjModel


@dataclass(frozen=True)
class CarParameters:
    """Parameters of the robot that its controller uses."""

    wheelbase: float  # distance between the axles, in metres
    half_track: float  # half the distance between the steering axes of the front wheels, in metres
    max_angle: float  # largest steering angle of a front wheel, in radians
    full_speed: float  # speed for a drive command of 1, in m/s

    @property
    def turning_radius(self) -> float:
        """Smallest turning radius of the midpoint of the rear axle, in metres; the inner wheel limits it."""
        return self.wheelbase / tan(self.max_angle) + self.half_track


def car_parameters(model: MjModel) -> CarParameters:
    """The parameters of a compiled model of the robot."""
    wheelbase, half_track, _ = model.body("front_left").pos
    drive = model.actuator("drive")
    radius = model.geom("rear_left").size[0]
    return CarParameters(
        wheelbase=float(wheelbase),
        half_track=float(half_track),
        max_angle=float(model.actuator("steer_left").ctrlrange[1]),
        full_speed=float(radius * drive.gainprm[0] / -drive.biasprm[2]),
    )
