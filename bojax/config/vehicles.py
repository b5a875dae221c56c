"""Settings of the robots behind a planning problem, and of their sensors."""

from typing import ClassVar, Literal

from bojax.config.component import Component


class Exact(Component, frozen=True):
    """A robot that follows every path exactly."""

    role: ClassVar[str] = "vehicle"
    target: ClassVar[str] = "bojax.problems.vehicles.base:Exact"

    kind: Literal["exact"] = "exact"


class Point(Component, frozen=True):
    """A sensor that reads the field at the robot's position."""

    role: ClassVar[str] = "sensor"
    target: ClassVar[str] = "bojax.problems.sensors:PointSensor"

    kind: Literal["point"] = "point"
