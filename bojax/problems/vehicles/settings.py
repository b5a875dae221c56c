"""Settings of the robots that drive planned paths."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component, Slot
from bojax.robots.settings import MJX


class VehicleSettings(Component, frozen=True):
    """A robot that drives planned paths."""

    role: ClassVar[str] = "vehicle"
    plural: ClassVar[str] = "robots that drive planned paths"
    protocol: ClassVar[str] = "bojax.problems.vehicles.base:Vehicle"


class Exact(VehicleSettings, frozen=True):
    """A robot that follows every path exactly."""

    target: ClassVar[str] = "bojax.problems.vehicles.base:Exact"

    kind: Literal["exact"] = "exact"


class WheeledRobot(VehicleSettings, frozen=True):
    """A small wheeled robot that tracks paths by pure pursuit, stepped by MJX (thesis, p. 101)."""

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


class Quadrotor(VehicleSettings, frozen=True):
    """A quadrotor that flies paths at a constant altitude, stepped by MJX (thesis, Section 3.5.2)."""

    target: ClassVar[str] = "bojax.problems.vehicles.quadrotor:Quadrotor"

    kind: Literal["quadrotor"] = "quadrotor"
    altitude: float = Field(default=1.5, gt=0, description="altitude of flight, m")
    physics: Annotated[Component, Slot("physics")] = Field(default=MJX(), description="how MJX computes")
    path_steps: int = Field(default=400, ge=1, description="steps of 10 ms for a path")
    rest_steps: int = Field(
        default=250, ge=1, description="steps of 10 ms after it, to turn and to come to rest"
    )
