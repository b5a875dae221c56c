"""Robot parking: the outcome of a path (4.13)."""

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Parking:
    """The problem as a planner knows it; a belief is a pose."""

    half_width: float
    distance_tolerance: float
    heading_tolerance: float
    bearing_tolerance: float
    success_reward: float
    exit_reward: float
    bearing: str
    success_needs_bearing: bool
    exit_terminates: bool
    park_along_path: bool

    def drive(self, pose, path, draws=None):
        """The pose, the reward and whether the episode is over after driving `path` from `pose`.

        Without chance: nothing is drawn.
        """
        path = place(path, pose)
        position = path[:, :2]
        is_outside = np.abs(position).max(axis=1) > self.half_width
        is_near = np.square(position).sum(axis=1) <= self.distance_tolerance**2
        if not self.park_along_path:
            is_near[:-1] = False
        # Most paths meet neither the border nor the lot: only the others are followed pose by pose.
        if is_outside.any() or is_near.any():
            has_left = False
            for i in np.flatnonzero(is_outside | is_near):
                if is_near[i] and self.is_aligned(path[i]):
                    return path[i], self.success_reward, True
                if is_outside[i] and self.exit_terminates:
                    return path[i], self.exit_reward, True
                has_left |= is_outside[i]
            if has_left and max(abs(pose[0]), abs(pose[1])) <= self.half_width:
                return path[-1], self.exit_reward, False
        return path[-1], self.shaped_reward(path[-1]), False

    def is_aligned(self, pose):
        """What a pose near the lot still needs to be parked."""
        is_along = abs(math.sin(pose[2])) <= self.heading_tolerance
        return is_along and (not self.success_needs_bearing or self.off_axis(pose) <= self.bearing_tolerance)

    def shaped_reward(self, pose):
        """(4.13) where the robot neither parked nor left."""
        d_max = math.hypot(self.half_width, self.half_width)
        off_axis, off_heading = self.off_axis(pose), abs(math.sin(pose[2]))
        if off_axis > self.bearing_tolerance:
            return -off_axis - d_max - 1.0
        if off_heading > self.heading_tolerance:
            return -off_heading - d_max
        return -math.hypot(pose[0], pose[1])

    def off_axis(self, pose):
        """|sin beta|."""
        x, y, alpha = pose
        if self.bearing == "robot":
            return abs(math.sin(math.atan2(-y, -x) - alpha)) if x or y else 0.0
        return abs(math.sin(math.atan2(y, x)))


def place(path, pose):
    """A path of the robot's frame, driven from `pose`."""
    x, y, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    placed = path @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    placed += pose
    return placed
