"""Settings of kernels and prior means."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, PlainSerializer, PlainValidator

from bojax.config.component import Component, Slot

LEAST, GREATEST = 1e-15, 1e15
"""Range of lengthscales and variances: between them, means and variances are finite even in 32 bits."""


def _positive(value: Any) -> float | tuple[float, ...]:
    """A positive number, or a tuple of them."""
    numbers = tuple(value) if isinstance(value, list | tuple) else (value,)
    are_numbers = all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers)
    if not (numbers and are_numbers and all(LEAST <= n <= GREATEST for n in numbers)):
        raise ValueError(f"allowed: a number from {LEAST:g} to {GREATEST:g} or a list of them")
    return tuple(map(float, numbers)) if isinstance(value, list | tuple) else float(value)


# Serialised by its value: pydantic's serialiser of the union warns of every tuple that becomes a list.
PositiveNumbers = Annotated[
    float | tuple[float, ...], PlainValidator(_positive), PlainSerializer(lambda value: value)
]
"""A positive number, or a list of them."""


class KernelSettings(Component, frozen=True):
    """A kernel."""

    role: ClassVar[str] = "kernel"
    plural: ClassVar[str] = "kernels"
    protocol: ClassVar[str] = "bojax.models.kernels:Kernel"


class _Stationary(KernelSettings, frozen=True):
    lengthscale: PositiveNumbers = Field(
        default=0.5, description="lengthscale, in units of the input: one number, or one a dimension"
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


class Scaled(KernelSettings, frozen=True):
    """A kernel times a constant."""

    target: ClassVar[str] = "bojax.models.kernels:Scaled"
    kind: Literal["scaled"] = "scaled"
    kernel: Annotated[Component, Slot("kernel")] = Field(default=RBF(), description="kernel to scale")
    variance: float = Field(
        default=1.0, ge=LEAST, le=GREATEST, description="the prior variance, in squared units of the value"
    )


class Warped(KernelSettings, frozen=True):
    """A kernel of warped inputs: functions vary faster in one part of a box than in another."""

    target: ClassVar[str] = "bojax.models.kernels:Warped"
    kind: Literal["warped"] = "warped"
    kernel: Annotated[Component, Slot("kernel")] = Field(default=RBF(), description="kernel of warped inputs")
    a: PositiveNumbers = Field(
        default=1.0, description="above 1, functions vary slowly near low: one number, or one a dimension"
    )
    b: PositiveNumbers = Field(
        default=1.0, description="above 1, functions vary slowly near high: one number, or one a dimension"
    )
    low: tuple[float, ...] = Field(
        default=(0.0, 0.0), min_length=1, strict=False, description="lower corner of the box"
    )
    high: tuple[float, ...] = Field(
        default=(1.0, 1.0), min_length=1, strict=False, description="upper corner of the box"
    )


class _Composite(KernelSettings, frozen=True):
    first: Annotated[Component, Slot("kernel")] = Field(default=RBF(), description="first kernel")
    second: Annotated[Component, Slot("kernel")] = Field(default=RBF(), description="second kernel")


class Sum(_Composite, frozen=True):
    """The sum of two kernels."""

    target: ClassVar[str] = "bojax.models.kernels:Sum"
    kind: Literal["sum"] = "sum"


class Product(_Composite, frozen=True):
    """The product of two kernels."""

    target: ClassVar[str] = "bojax.models.kernels:Product"
    kind: Literal["product"] = "product"


class MeanSettings(Component, frozen=True):
    """A prior mean."""

    role: ClassVar[str] = "mean"
    plural: ClassVar[str] = "prior means"
    protocol: ClassVar[str] = "bojax.models.means:Mean"


class ZeroMean(MeanSettings, frozen=True):
    """A prior mean of zero."""

    target: ClassVar[str] = "bojax.models.means:ZeroMean"
    kind: Literal["zero"] = "zero"


class ConstantMean(MeanSettings, frozen=True):
    """A constant prior mean."""

    target: ClassVar[str] = "bojax.models.means:ConstantMean"
    kind: Literal["constant"] = "constant"
    value: float = Field(default=0.0, description="prior mean, in units of the value")


class LinearMean(MeanSettings, frozen=True):
    """A prior mean that is linear in the input."""

    target: ClassVar[str] = "bojax.models.means:LinearMean"
    kind: Literal["linear"] = "linear"
    weights: tuple[float, ...] = Field(
        default=(0.0, 0.0), strict=False, min_length=1, description="slope along each dimension"
    )
    bias: float = Field(default=0.0, description="prior mean at the origin, in units of the value")
