"""The MuJoCo model of the quadrotor."""

from bojax.robots.models import RobotModel, packaged


def quadrotor_model() -> RobotModel:
    """The quadrotor in an empty world."""
    return packaged("quadrotor")
