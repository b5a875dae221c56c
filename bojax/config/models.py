"""Settings of kernels and acquisition functions."""

from typing import ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component


class _Stationary(Component, frozen=True):
    role: ClassVar[str] = "kernel"

    lengthscale: float = Field(default=0.5, gt=0, description="lengthscale, in units of the input")


class RBF(_Stationary, frozen=True):
    """Squared-exponential kernel (thesis, equation 2.26)."""

    target: ClassVar[str] = "bojax.models.kernels:RBF"
    kind: Literal["rbf"] = "rbf"


class Matern12(_Stationary, frozen=True):
    """Matern kernel of smoothness 1/2, the exponential kernel."""

    target: ClassVar[str] = "bojax.models.kernels:Matern12"
    kind: Literal["matern12"] = "matern12"


class Matern32(_Stationary, frozen=True):
    """Matern kernel of smoothness 3/2."""

    target: ClassVar[str] = "bojax.models.kernels:Matern32"
    kind: Literal["matern32"] = "matern32"


class Matern52(_Stationary, frozen=True):
    """Matern kernel of smoothness 5/2."""

    target: ClassVar[str] = "bojax.models.kernels:Matern52"
    kind: Literal["matern52"] = "matern52"


class UpperConfidenceBound(Component, frozen=True):
    """Mean plus kappa standard deviations."""

    role: ClassVar[str] = "acquisition"
    target: ClassVar[str] = "bojax.acquisition.functions:UpperConfidenceBound"

    kind: Literal["ucb"] = "ucb"
    kappa: float = Field(default=10.0, ge=0, description="weight of the standard deviation")


class ProbabilityOfImprovement(Component, frozen=True):
    """Probability of exceeding the best value so far."""

    role: ClassVar[str] = "acquisition"
    target: ClassVar[str] = "bojax.acquisition.functions:ProbabilityOfImprovement"

    kind: Literal["pi"] = "pi"
    xi: float = Field(default=0.01, ge=0, description="improvement that is asked for, in units of the target")


class LogExpectedImprovement(Component, frozen=True):
    """Logarithm of the expected improvement over the best value so far."""

    role: ClassVar[str] = "acquisition"
    target: ClassVar[str] = "bojax.acquisition.functions:LogExpectedImprovement"

    kind: Literal["log-ei"] = "log-ei"
    xi: float = Field(default=0.01, ge=0, description="improvement that is asked for, in units of the target")
