"""The parking reward (4.13) in plain Python, pose by pose, with the corrections that `Parking` states."""

from dataclasses import dataclass
from math import atan2, hypot, pi, sin, sqrt


@dataclass(frozen=True)
class Settings:
    """The thesis's constants, and the choices that it leaves open."""

    half_width: float = 4.0
    distance_tolerance: float = 0.1
    heading_tolerance: float = pi / 10
    bearing_tolerance: float = pi / 10
    success_reward: float = 1000.0
    exit_reward: float = -1000.0
    bearing: str = "world"
    success_needs_bearing: bool = False
    exit_terminates: bool = True
    park_along_path: bool = True


@dataclass(frozen=True)
class Result:
    """What a path leads to; `branch` names the line of (4.13) that paid."""

    branch: str
    reward: float
    terminated: bool
    success: bool
    exited: bool
    last: int


def bearing_of(pose, settings: Settings) -> float:
    """beta: where the robot is seen from the lot, or where the lot is seen from the robot's heading."""
    x, y, heading = pose
    if settings.bearing == "world":
        return atan2(y, x)
    return atan2(-y, -x) - heading


def is_off_axis(pose, settings: Settings) -> bool:
    at_the_lot = pose[0] == 0.0 and pose[1] == 0.0  # no bearing there
    return not at_the_lot and abs(sin(bearing_of(pose, settings))) > settings.bearing_tolerance


def is_off_heading(pose, settings: Settings) -> bool:
    return abs(sin(pose[2])) > settings.heading_tolerance


def is_parked(pose, settings: Settings) -> bool:
    if settings.success_needs_bearing and is_off_axis(pose, settings):
        return False
    return hypot(pose[0], pose[1]) <= settings.distance_tolerance and not is_off_heading(pose, settings)


def is_inside(pose, settings: Settings) -> bool:
    return abs(pose[0]) <= settings.half_width and abs(pose[1]) <= settings.half_width


def shaped(pose, settings: Settings) -> tuple[str, float]:
    """The first three lines of (4.13)."""
    d_max = sqrt(2.0) * settings.half_width
    if is_off_axis(pose, settings):
        return "off axis", -abs(sin(bearing_of(pose, settings))) - d_max - 1.0
    if is_off_heading(pose, settings):
        return "off heading", -abs(sin(pose[2])) - d_max
    return "on axis", -hypot(pose[0], pose[1])


def outcome(start, path, settings: Settings) -> Result:
    """Drive through the poses of `path` until something ends it."""
    exited = False
    for index, pose in enumerate(path):
        if not is_inside(pose, settings):
            if settings.exit_terminates:
                return Result("exit", settings.exit_reward, True, False, True, index)
            exited = exited or is_inside(start, settings)
        if is_parked(pose, settings) and (settings.park_along_path or index == len(path) - 1):
            return Result("parked", settings.success_reward, True, True, exited, index)
    branch, reward = ("exit", settings.exit_reward) if exited else shaped(path[-1], settings)
    return Result(branch, reward, False, False, exited, len(path) - 1)
