"""Settings of what a sample of a field is worth."""

from typing import ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component


class _Objective(Component, frozen=True):
    role: ClassVar[str] = "objective"

    uncertainty: Literal["std", "variance"] = Field(
        default="std", description="whether the standard deviation or the variance counts"
    )


class Gradient(_Objective, frozen=True):
    """Norm of the gradient plus kappa standard deviations (thesis, equation 3.2)."""

    target: ClassVar[str] = "bojax.problems.objectives:GradientObjective"

    kind: Literal["gradient"] = "gradient"
    kappa: float = Field(default=5.0, ge=0, description="weight of the standard deviation")


class Value(_Objective, frozen=True):
    """Mean plus kappa standard deviations (thesis, equation 4.11; SBO)."""

    target: ClassVar[str] = "bojax.problems.objectives:ValueObjective"

    kind: Literal["value"] = "value"
    kappa: float = Field(default=10.0, ge=0, description="weight of the standard deviation")


class Uncertainty(_Objective, frozen=True):
    """The standard deviation alone (thesis, Section 3.5.1: the explorer)."""

    target: ClassVar[str] = "bojax.problems.objectives:UncertaintyObjective"

    kind: Literal["uncertainty"] = "uncertainty"
