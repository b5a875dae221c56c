"""Settings of the experiments: what one run does."""

from typing import Annotated, ClassVar, Literal, Self

import pydantic
from pydantic import Field

from bojax.config.component import Component, External, Slot
from bojax.config.motions import KernelTrajectories
from bojax.config.planners import KCBTS
from bojax.config.problems import FieldProblem, Parking


class _Experiment(Component, frozen=True):
    role: ClassVar[str] = "experiment"

    dtype: Literal["float64", "float32"] = Field(default="float64", description="precision of every number")


class Planning(_Experiment, frozen=True):
    """One episode of a planner on a problem."""

    target: ClassVar[str] = "bojax.experiments.planning:PlanningEpisode"

    kind: Literal["planning"] = "planning"
    problem: Annotated[Component, Slot("problem")] = Field(
        default=Parking(), description="what is planned on"
    )
    planner: Annotated[Component, Slot("planner")] = Field(default=KCBTS(), description="who plans")

    @pydantic.model_validator(mode="after")
    def _objective_of_a_field(self) -> Self:
        is_known = not isinstance(self.problem, External | FieldProblem)
        if is_known and getattr(self.planner, "objective", None) is not None:
            raise ValueError(
                f"planner.objective: {self.planner.label} wants to learn a field, and {self.problem.label} "
                "has none: set planner.objective to null, or choose another planner"
            )
        return self

    @property
    def label(self) -> str:
        """The planner's name."""
        return self.planner.label


class Trajectories(_Experiment, frozen=True):
    """A gallery of trajectories of one family, from one pose (thesis, Fig. 4.2)."""

    target: ClassVar[str] = "bojax.experiments.trajectories:TrajectoryGallery"

    kind: Literal["trajectories"] = "trajectories"
    motions: Annotated[Component, Slot("motions")] = Field(
        default=KernelTrajectories(), description="the family of trajectories"
    )
    levels: int = Field(default=3, ge=1, description="values of each parameter of a continuous family")

    @property
    def label(self) -> str:
        """The name of the family."""
        return self.motions.label
