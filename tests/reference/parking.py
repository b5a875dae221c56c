"""Robot parking: the outcome of a path (4.13), pose by pose, with the corrections that `Parking` states."""

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np


@dataclass(frozen=True)
class Outcome:
    """What a path leads to; `branch` names the line of (4.13) that paid."""

    branch: str
    reward: float
    terminated: bool
    success: bool
    exited: bool
    last: int


@dataclass(frozen=True)
class Parking:
    """The thesis's constants, and the choices that it leaves open; a belief is a pose."""

    half_width: float = 4.0
    distance_tolerance: float = 0.1
    heading_tolerance: float = pi / 10
    bearing_tolerance: float = pi / 10
    success_reward: float = 1000.0
    exit_reward: float = -1000.0
    bearing: str = "world"
    rule: str = "printed"
    exit_terminates: bool = True

    def drive(self, pose, path, draws=None):
        """The pose, the reward and whether the episode is over after driving `path`; nothing is drawn."""
        path = place(path, pose)
        found = self.outcome(pose, path)
        return path[found.last], found.reward, found.terminated

    def outcome(self, start, path) -> Outcome:
        """Drive through the poses of `path` until something ends it."""
        exited = False
        for index, pose in enumerate(path):
            if not self.is_inside(pose):
                if self.exit_terminates:
                    return Outcome("exit", self.exit_reward, True, False, True, index)
                exited = exited or self.is_inside(start)
            if self.is_parked(pose) and (self.rule.startswith("anywhere") or index == len(path) - 1):
                return Outcome("parked", self.success_reward, True, True, exited, index)
        branch, reward = ("exit", self.exit_reward) if exited else self.shaped(path[-1])
        return Outcome(branch, reward, False, False, exited, len(path) - 1)

    def is_inside(self, pose) -> bool:
        return abs(pose[0]) <= self.half_width and abs(pose[1]) <= self.half_width

    def is_parked(self, pose) -> bool:
        if not self.rule.endswith("bearing-dropped") and self.off_axis(pose) > self.bearing_tolerance:
            return False
        return hypot(pose[0], pose[1]) <= self.distance_tolerance and not self.is_off_heading(pose)

    def is_off_heading(self, pose) -> bool:
        return abs(sin(pose[2])) > self.heading_tolerance

    def off_axis(self, pose) -> float:
        """|sin beta|: where the robot is seen from the lot, or the lot from the robot's heading."""
        x, y, heading = pose
        if x == 0.0 and y == 0.0:  # no bearing there
            return 0.0
        return abs(sin(atan2(y, x) if self.bearing == "world" else atan2(-y, -x) - heading))

    def shaped(self, pose) -> tuple[str, float]:
        """The first three lines of (4.13)."""
        d_max, off_axis = sqrt(2.0) * self.half_width, self.off_axis(pose)
        if off_axis > self.bearing_tolerance:
            return "off axis", -off_axis - d_max - 1.0
        if self.is_off_heading(pose):
            return "off heading", -abs(sin(pose[2])) - d_max
        return "on axis", -hypot(pose[0], pose[1])


def place(path, pose):
    """A path of the robot's frame, driven from `pose`."""
    c, s = cos(pose[2]), sin(pose[2])
    return path @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + pose
