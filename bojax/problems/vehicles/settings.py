"""Settings of the robots that execute planned paths."""

from typing import ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component
from bojax.robots.settings import MJX, PhysicsEngine


class VehicleSettings(Component, frozen=True):
    """A robot that executes planned paths."""

    role: ClassVar[str] = "vehicle"
    plural: ClassVar[str] = "robots that execute planned paths"
    protocol: ClassVar[str] = "bojax.problems.vehicles.base:Vehicle"


class Exact(VehicleSettings, frozen=True):
    """A vehicle that follows every path exactly and can turn on the spot."""

    target: ClassVar[str] = "bojax.problems.vehicles.base:Exact"
    kind: Literal["exact"] = "exact"


class WheeledRobot(VehicleSettings, frozen=True):
    """A small wheeled robot that tracks paths by pure pursuit, simulated by MJX (thesis, p. 101)."""

    target: ClassVar[str] = "bojax.problems.vehicles.wheeled_robot:WheeledRobot"
    kind: Literal["wheeled-robot"] = "wheeled-robot"
    look_ahead: float = Field(default=0.15, gt=0, description="look-ahead distance of pure pursuit, m")
    speed: float = Field(default=0.5, gt=0, le=0.75, description="cruising speed, m/s")
    gain: float = Field(default=6.0, gt=0, description="final speed per metre to the end of the path, 1/s")
    physics: PhysicsEngine = MJX()
    substeps: int = Field(default=5, ge=1, description="steps of 10 ms between two measurements of the pose")
    readings: int = Field(default=50, ge=2, description="number of pose readings per path, while it drives")
    rest_readings: int = Field(
        default=10, ge=0, description="number of pose readings after a path, without drive, to come to rest"
    )


class Quadrotor(VehicleSettings, frozen=True):
    """A quadrotor that flies paths at a constant altitude, simulated by MJX (thesis, Section 3.5.2)."""

    target: ClassVar[str] = "bojax.problems.vehicles.quadrotor:Quadrotor"
    kind: Literal["quadrotor"] = "quadrotor"
    altitude: float = Field(default=1.5, gt=0, description="flight altitude, m")
    physics: PhysicsEngine = MJX()
    path_steps: int = Field(default=400, ge=1, description="simulation steps of 10 ms per path")
    rest_steps: int = Field(default=250, ge=1, description="steps of 10 ms after a path, to turn and rest")
