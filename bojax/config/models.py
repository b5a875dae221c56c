"""Settings of kernels, prior means and acquisition functions."""

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, PlainSerializer, PlainValidator

from bojax.config.component import Component, Slot


def _positive(value: Any) -> float | tuple[float, ...]:
    """A positive number, or some of them."""
    numbers = tuple(value) if isinstance(value, list | tuple) else (value,)
    are_numbers = all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers)
    if not (numbers and are_numbers and all(0 < n < math.inf for n in numbers)):
        raise ValueError("allowed: a number > 0 or a list of them")
    return tuple(map(float, numbers)) if isinstance(value, list | tuple) else float(value)


# Serialised by its value: pydantic's serialiser of the union warns of every tuple that it makes a list.
PositiveNumbers = Annotated[
    float | tuple[float, ...], PlainValidator(_positive), PlainSerializer(lambda value: value)
]
"""A positive number, or a list of them."""


class _Stationary(Component, frozen=True):
    role: ClassVar[str] = "kernel"

    lengthscale: PositiveNumbers = Field(
        default=0.5, description="lengthscale, in units of the input: one number, or one a dimension; > 0"
    )


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


class Scaled(Component, frozen=True):
    """A kernel times a constant."""

    role: ClassVar[str] = "kernel"
    target: ClassVar[str] = "bojax.models.kernels:Scaled"

    kind: Literal["scaled"] = "scaled"
    kernel: Annotated[Component, Slot("kernel")] = Field(default=RBF(), description="the kernel")
    variance: float = Field(default=1.0, gt=0, description="the constant, in units of the value, squared")


class _Composite(Component, frozen=True):
    role: ClassVar[str] = "kernel"

    first: Annotated[Component, Slot("kernel")] = Field(default=RBF(), description="one kernel")
    second: Annotated[Component, Slot("kernel")] = Field(default=RBF(), description="another kernel")


class Sum(_Composite, frozen=True):
    """The sum of two kernels."""

    target: ClassVar[str] = "bojax.models.kernels:Sum"
    kind: Literal["sum"] = "sum"


class Product(_Composite, frozen=True):
    """The product of two kernels."""

    target: ClassVar[str] = "bojax.models.kernels:Product"
    kind: Literal["product"] = "product"


class ZeroMean(Component, frozen=True):
    """No expectation: a prior mean of zero."""

    role: ClassVar[str] = "mean"
    target: ClassVar[str] = "bojax.models.means:ZeroMean"

    kind: Literal["zero"] = "zero"


class ConstantMean(Component, frozen=True):
    """The same prior mean everywhere."""

    role: ClassVar[str] = "mean"
    target: ClassVar[str] = "bojax.models.means:ConstantMean"

    kind: Literal["constant"] = "constant"
    value: float = Field(default=0.0, description="prior mean, in units of the value")


class LinearMean(Component, frozen=True):
    """A prior mean that is linear in the input."""

    role: ClassVar[str] = "mean"
    target: ClassVar[str] = "bojax.models.means:LinearMean"

    kind: Literal["linear"] = "linear"
    weights: tuple[float, ...] = Field(
        default=(0.0, 0.0), strict=False, min_length=1, description="slope, one number a dimension"
    )
    bias: float = Field(default=0.0, description="prior mean at the origin, in units of the value")


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
