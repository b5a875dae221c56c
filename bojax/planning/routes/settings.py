"""Settings of planners that follow routes from files."""

from typing import Any, ClassVar, Literal

import pydantic
from pydantic import Field

from bojax.config.component import RECORDED
from bojax.fields.data import read_waypoints, sha256_of_files
from bojax.planning.settings import PlannerSettings


class RouteSettings(PlannerSettings, frozen=True):
    """A planner that follows a route from a file."""

    target: ClassVar[str] = "bojax.planning.routes.follower:RouteFollower"

    file: str = Field(
        min_length=1,
        description="a .csv or .npy file of waypoints, relative to the working directory: columns x and y, m",
    )
    length: float = Field(default=1.0, gt=0, description="length of the piece of a step, m")
    num_samples: int = Field(default=10, ge=2, description="poses of a piece")
    sha256: str | None = Field(default=None, description="SHA-256 of the file; null to compute it")

    @pydantic.model_validator(mode="after")
    def _readable(self, info: Any) -> "RouteSettings":
        if info.context is RECORDED and self.sha256 is not None:
            return self
        read_waypoints(self.file)
        digest = sha256_of_files(self.file)
        if self.sha256 is None:
            object.__setattr__(self, "sha256", digest)
        elif self.sha256 != digest:
            raise ValueError(f"{self.file}: the file has changed: its SHA-256 differs")
        return self


class Route(RouteSettings, frozen=True):
    """A route from a file, as `bojax survey` writes it, driven piece by piece on a field."""

    kind: Literal["route"] = "route"


class Lawnmower(RouteSettings, frozen=True):
    """The same, for a lawnmower: `bojax survey` writes the best one as `lawnmower.csv`."""

    kind: Literal["lawnmower"] = "lawnmower"
