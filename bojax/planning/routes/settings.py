"""Settings of planners that follow a route."""

from typing import Any, ClassVar, Literal

import pydantic
from pydantic import Field

from bojax.config.component import RECORDED
from bojax.fields.data import read_waypoints, record_sha256
from bojax.planning.settings import PlannerSettings


class RouteSettings(PlannerSettings, frozen=True):
    """A route, driven piece by piece on a field."""

    length: float = Field(default=1.0, gt=0, description="length of the piece of a step, m")
    num_samples: int = Field(default=10, ge=2, description="poses of a piece")


class Route(RouteSettings, frozen=True):
    """A route from a file, as `bojax survey` writes it, driven piece by piece on a field."""

    target: ClassVar[str] = "bojax.planning.routes.follower:RouteFollower"
    kind: Literal["route"] = "route"
    file: str = Field(
        min_length=1,
        description="a .csv or .npy file of waypoints, relative to the working directory: columns x and y, m",
    )
    sha256: str | None = Field(default=None, description="SHA-256 of the file; null to compute it")

    @pydantic.model_validator(mode="after")
    def _readable(self, info: Any) -> "Route":
        if info.context is RECORDED and self.sha256 is not None:
            return self
        read_waypoints(self.file)
        record_sha256(self, self.file)
        return self
