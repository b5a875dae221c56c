"""The Jaco arm with some of its joints immobilised (thesis, Section 5.7.3)."""

from collections.abc import Collection

from bojax.robots.models import RobotModel, packaged

NUM_JOINTS = 6


def jaco_model(joints: Collection[int]) -> RobotModel:
    """The arm with only these joints movable, numbered from 1 at the base to 6 at the hand.

    The other joints are fixed in the upright configuration of the arm and have no motor.
    """
    spec = packaged("jaco").spec()
    for number in range(1, NUM_JOINTS + 1):
        if number not in joints:
            for part in (spec.actuator(f"joint_{number}"), spec.joint(f"joint_{number}")):
                spec.delete(part)
    return RobotModel(spec.to_xml())
