"""Settings of the planner that drives a lawnmower."""

from math import pi
from typing import ClassVar, Literal

from pydantic import Field

from bojax.planning.settings import RouteSettings


class Lawnmower(RouteSettings, frozen=True):
    """Parallel lines over the area of a field, laid before the first step and driven piece by piece."""

    target: ClassVar[str] = "bojax.surveys.lawnmower_planner:Lawnmower"
    kind: Literal["lawnmower"] = "lawnmower"
    spacing: float | None = Field(
        default=None,
        gt=0,
        description="largest distance between two lines, m; null: the lines that cover the area and are as "
        "long as the budget, or as `problem.max_steps` pieces",
    )
    direction: float | None = Field(
        default=None,
        ge=-2 * pi,
        le=2 * pi,
        description="direction of the lines, counter-clockwise from x, rad; null: the one of eight whose "
        "route passes closest to the points of the area",
    )
