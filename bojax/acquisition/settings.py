"""Settings of the acquisition functions."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component
from bojax.models.settings import GREATEST


class AcquisitionSettings(Component, frozen=True):
    """An acquisition function."""

    role: ClassVar[str] = "acquisition"
    plural: ClassVar[str] = "acquisition functions"
    protocol: ClassVar[str] = "bojax.acquisition.functions:Acquisition"


_Improvement = Annotated[
    float,
    Field(ge=0, le=GREATEST, description="required improvement over the best value, in units of the target"),
]


class UpperConfidenceBound(AcquisitionSettings, frozen=True):
    """Mean plus kappa times the uncertainty (thesis, equations 2.37 and 4.3)."""

    target: ClassVar[str] = "bojax.acquisition.functions:UpperConfidenceBound"
    kind: Literal["ucb"] = "ucb"
    kappa: float = Field(default=10.0, ge=0, le=GREATEST, description="weight of the uncertainty")
    uncertainty: Literal["std", "variance"] = Field(
        default="std", description="measure of uncertainty: standard deviation or variance"
    )


class ProbabilityOfImprovement(AcquisitionSettings, frozen=True):
    """Probability of improving on the best value so far by more than xi (thesis, equation 2.36)."""

    target: ClassVar[str] = "bojax.acquisition.functions:ProbabilityOfImprovement"
    kind: Literal["pi"] = "pi"
    xi: _Improvement = 0.01


class ExpectedImprovement(AcquisitionSettings, frozen=True):
    """Expected improvement over the best value so far plus xi (Jones, Schonlau and Welch, 1998)."""

    target: ClassVar[str] = "bojax.acquisition.functions:ExpectedImprovement"
    kind: Literal["ei"] = "ei"
    xi: _Improvement = 0.01


class LogExpectedImprovement(AcquisitionSettings, frozen=True):
    """Logarithm of the expected improvement over the best value so far plus xi (Ament et al., 2023)."""

    target: ClassVar[str] = "bojax.acquisition.functions:LogExpectedImprovement"
    kind: Literal["log-ei"] = "log-ei"
    xi: _Improvement = 0.01
