"""Settings of the problems that are planned on."""

from math import pi
from typing import ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component


class Parking(Component, frozen=True):
    """Robot parking: reach the centre of a square at a given heading (thesis, Section 4.7.2)."""

    role: ClassVar[str] = "problem"
    target: ClassVar[str] = "bojax.problems.parking:Parking"

    kind: Literal["parking"] = "parking"
    half_width: float = Field(default=4.0, gt=0, description="half the width of the square domain, m")
    max_steps: int = Field(default=15, ge=1, description="steps after which an episode ends")
    distance_tolerance: float = Field(
        default=0.1, gt=0, description="largest distance from the goal when parked, m"
    )
    heading_tolerance: float = Field(
        default=pi / 10, gt=0, description="largest |sin| of the heading when parked"
    )
    bearing_tolerance: float = Field(
        default=pi / 10, gt=0, description="largest |sin| of the bearing when parked"
    )
    success_reward: float = Field(default=1000.0, description="reward of parking")
    exit_reward: float = Field(default=-1000.0, description="reward of leaving the domain")
    position_noise: float = Field(
        default=0.02, ge=0, description="standard deviation of the observed position, m"
    )
    heading_noise: float = Field(
        default=0.02, ge=0, description="standard deviation of the observed heading, rad"
    )
    bearing: Literal["world", "robot"] = Field(
        default="world", description="whether the robot is seen from the lot, or the lot from the robot"
    )
    success_needs_bearing: bool = Field(
        default=False, description="whether parking also needs the bearing condition"
    )
    exit_terminates: bool = Field(default=True, description="whether leaving the domain ends the episode")
    park_along_path: bool = Field(
        default=True, description="whether passing through the goal region counts as parking"
    )
