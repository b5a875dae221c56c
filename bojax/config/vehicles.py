"""Settings of the robots behind a planning problem, and of their sensors."""

from math import pi
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component, Slot
from bojax.config.physics import MJX


class Exact(Component, frozen=True):
    """A robot that follows every path exactly."""

    role: ClassVar[str] = "vehicle"
    target: ClassVar[str] = "bojax.problems.vehicles.base:Exact"

    kind: Literal["exact"] = "exact"


class WheeledRobot(Component, frozen=True):
    """A small wheeled robot that tracks paths by pure pursuit, stepped by MJX (thesis, p. 101)."""

    role: ClassVar[str] = "vehicle"
    target: ClassVar[str] = "bojax.problems.vehicles.wheeled_robot:WheeledRobot"

    kind: Literal["wheeled-robot"] = "wheeled-robot"
    look_ahead: float = Field(
        default=0.15, gt=0, description="how far ahead on the path it looks for where to steer, m"
    )
    speed: float = Field(default=0.5, gt=0, le=0.75, description="speed, m/s")
    gain: float = Field(default=6.0, gt=0, description="speed for each metre left, 1/s")
    physics: Annotated[Component, Slot("physics")] = Field(default=MJX(), description="how MJX computes")
    substeps: int = Field(default=5, ge=1, description="steps of 10 ms between two readings of its pose")
    readings: int = Field(
        default=50, ge=2, description="readings while it follows a path, which has to be over by then"
    )


class Point(Component, frozen=True):
    """A sensor that reads the field at the robot's position."""

    role: ClassVar[str] = "sensor"
    target: ClassVar[str] = "bojax.problems.sensors:PointSensor"

    kind: Literal["point"] = "point"


class Quadrotor(Component, frozen=True):
    """A quadrotor that flies paths at a constant altitude, stepped by MJX (thesis, Section 3.5.2)."""

    role: ClassVar[str] = "vehicle"
    target: ClassVar[str] = "bojax.problems.vehicles.quadrotor:Quadrotor"

    kind: Literal["quadrotor"] = "quadrotor"
    altitude: float = Field(default=1.5, gt=0, description="altitude of flight, m")
    physics: Annotated[Component, Slot("physics")] = Field(default=MJX(), description="how MJX computes")
    path_steps: int = Field(default=400, ge=1, description="steps of 10 ms for a path")
    rest_steps: int = Field(
        default=250, ge=1, description="steps of 10 ms after it, to turn and to come to rest"
    )


class Range(Component, frozen=True):
    """A range sensor that looks down: the height of the ground, by the distance to it (thesis, p. 76-78)."""

    role: ClassVar[str] = "sensor"
    target: ClassVar[str] = "bojax.problems.sensors:RangeSensor"

    kind: Literal["range"] = "range"
    beam: float = Field(default=pi / 60, ge=0, lt=pi, description="full opening angle of the beam, rad")
    max_range: float = Field(default=5.0, gt=0, description="how far it sees, m")
    altitude_noise: float = Field(
        default=0.02, ge=0, description="standard deviation of a reading of the altitude, m"
    )
    rays: int = Field(default=7, ge=1, description="rays in the beam")
    reading: Literal["mean", "minimum"] = Field(
        default="mean", description="which distance of those along the rays it tells"
    )
    upright: bool = Field(
        default=True, description="whether the height takes account of how far the robot leans"
    )
