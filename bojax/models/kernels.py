"""Kernels: stationary covariance functions, sums and products, written for two points and batched outside."""

import abc
import functools
import operator
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Scalar
from typing_extensions import override

from bojax.models.checks import as_numbers, by_name, check_kind

KernelName: TypeAlias = str | Mapping[str, Any]
"""A kernel as in a config file: its name, or a mapping with its `kind` and settings."""

_BORDER = 1e-6
"""Share of a box that counts as its border."""

FAR = 1e3
"""Maximum scaled distance, to which longer ones are reduced; every covariance underflows to 0 before it."""


def _floats(numbers: float | Iterable[float]) -> tuple[float, ...]:
    """Numbers as a tuple; a single one has a dimension of its own."""
    return tuple(map(float, np.atleast_1d(np.asarray(numbers, float))))


class Kernel(eqx.Module):
    """A covariance function k(x, y); `+` and `*` combine two kernels into their sum and product.

    `RBF` and the Matern kernels have k(x, x) = 1, and one lengthscale or one for each dimension.
    Hyper-parameters may be given as Python numbers or lists.
    """

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        """Covariance of the values at two points."""

    def __add__(self, other: "Kernel") -> "Sum":
        """The covariance of a sum of two independent functions."""
        return Sum(self, other)

    def __mul__(self, other: "Kernel") -> "Product":
        """The covariance of a product of two independent functions of mean zero."""
        return Product(self, other)

    def stretched(self, unit: Float[Array, ""] | Float[Array, "D"]) -> "Kernel":
        """The covariance k(x / unit, y / unit), whose inputs are in other units."""
        return _Stretched(self, unit)

    def scaled(self, variance: Float[Array, ""]) -> "Kernel":
        """The covariance variance * k(x, y), whose values are in other units."""
        return Scaled(self, variance)

    def gram(self, xs: Float[Array, "N D"], ys: Float[Array, "M D"]) -> Float[Array, "N M"]:
        """Covariances of all pairs."""
        return jax.vmap(lambda x: jax.vmap(lambda y: self(x, y))(ys))(xs)


def as_kernel(given: Any) -> Kernel:
    """The kernel itself, or the kernel of a name or of settings.

    Raises:
        ValueError: It is none of these, there is no kernel of this name, or a setting is wrong.
    """
    kernel = by_name("kernel")(given)
    check_kind("kernel", kernel, Kernel, "RBF(0.5)")
    return kernel


class _Stationary(Kernel):
    """A function of the distance of two points in lengthscales."""

    lengthscale: Float[Array, ""] | Float[Array, "D"] = eqx.field(converter=as_numbers("lengthscale"))

    @override
    def stretched(self, unit: Float[Array, ""] | Float[Array, "D"]) -> "Kernel":
        return replace(self, lengthscale=self.lengthscale * unit)


class RBF(_Stationary):
    """Squared exponential kernel, exp(-r^2/2) with scaled distance r (2.26, printed with the wrong sign).

    Settings: `bojax.models.settings.RBF`.
    """

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        return jnp.exp(-0.5 * _squared_distance(x, y, self.lengthscale))


class Matern12(_Stationary):
    """Matern kernel of smoothness 1/2, exp(-r): the exponential kernel.

    Settings: `bojax.models.settings.Matern12`.
    """

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        return jnp.exp(-_distance(x, y, self.lengthscale))


class Matern32(_Stationary):
    """Matern kernel of smoothness 3/2, (1 + s) exp(-s) with s = sqrt(3) r.

    Settings: `bojax.models.settings.Matern32`.
    """

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        s = 3.0**0.5 * _distance(x, y, self.lengthscale)
        return (1.0 + s) * jnp.exp(-s)


class Matern52(_Stationary):
    """Matern kernel of smoothness 5/2, (1 + s + s^2/3) exp(-s) with s = sqrt(5) r.

    Settings: `bojax.models.settings.Matern52`.
    """

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        s = 5.0**0.5 * _distance(x, y, self.lengthscale)
        return (1.0 + s + s * s / 3.0) * jnp.exp(-s)


class Scaled(Kernel):
    """A kernel multiplied by a constant, which is the prior variance if the kernel has k(x, x) = 1.

    Settings: `bojax.models.settings.Scaled`.
    """

    kernel: Kernel
    variance: Float[Array, ""] = eqx.field(converter=as_numbers("variance"))

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        return self.variance * self.kernel(x, y)

    @override
    def stretched(self, unit: Float[Array, ""] | Float[Array, "D"]) -> Kernel:
        return Scaled(self.kernel.stretched(unit), self.variance)

    @override
    def scaled(self, variance: Float[Array, ""]) -> Kernel:
        return Scaled(self.kernel, self.variance * variance)


class Warped(Kernel):
    """A kernel of warped inputs, whose functions vary faster in one part of a box than in another.

    Each coordinate u in [0, 1] of the box becomes 1 - (1 - u^a)^b, the distribution function of Kumaraswamy
    (Snoek et al., Input warping for Bayesian optimization of non-stationary functions, 2014, with the beta
    distribution, which it resembles). With a = b = 1, and outside the box, inputs stay as they are.

    Settings: `bojax.models.settings.Warped`.

    Attributes:
        kernel: The kernel of the warped inputs, in units of the input.
        a: First exponent, of all dimensions or of each. With a > 1, functions vary slowly near `low`.
        b: Second exponent. With b > 1, functions vary slowly near `high`.
        low: Lower corner of the box; not learned.
        high: Upper corner.
    """

    kernel: Kernel
    a: Float[Array, ""] | Float[Array, "D"] = eqx.field(converter=as_numbers("a"))
    b: Float[Array, ""] | Float[Array, "D"] = eqx.field(converter=as_numbers("b"))
    low: tuple[float, ...] = eqx.field(static=True, converter=_floats)
    high: tuple[float, ...] = eqx.field(static=True, converter=_floats)

    def __check_init__(self):
        if len(self.low) != len(self.high) or not np.all(np.less(self.low, self.high)):
            got = f"{list(self.low)} and {list(self.high)}"
            raise ValueError(f"low, high: got {got}; allowed: corners of a box, low < high in each dimension")

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        return self.kernel(self._warped(x), self._warped(y))

    def _warped(self, x: Float[Array, "D"]) -> Float[Array, "D"]:
        low, high = (jnp.asarray(each, x.dtype) for each in (self.low, self.high))
        u = (x - low) / (high - low)
        # Powers have infinite derivatives at 0: the last 1e-6 of the box count as its border.
        inner = jnp.clip(u, _BORDER, 1.0 - _BORDER)
        warped = 1.0 - (1.0 - inner**self.a) ** self.b
        return low + (high - low) * jnp.where((u > 0.0) & (u < 1.0), warped, u)


class _Stretched(Kernel):
    """A kernel of inputs in other units, k(x / unit, y / unit), for kernels without a lengthscale."""

    kernel: Kernel
    unit: Float[Array, ""] | Float[Array, "D"] = eqx.field(converter=as_numbers("unit"))

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        return self.kernel(x / self.unit, y / self.unit)


class Sum(Kernel):
    """The sum of two kernels.

    Settings: `bojax.models.settings.Sum`.
    """

    first: Kernel
    second: Kernel

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        return self.first(x, y) + self.second(x, y)

    @override
    def stretched(self, unit: Float[Array, ""] | Float[Array, "D"]) -> Kernel:
        return Sum(self.first.stretched(unit), self.second.stretched(unit))

    @override
    def scaled(self, variance: Float[Array, ""]) -> Kernel:
        return Sum(self.first.scaled(variance), self.second.scaled(variance))


class Product(Kernel):
    """The product of two kernels.

    Settings: `bojax.models.settings.Product`.
    """

    first: Kernel
    second: Kernel

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        return self.first(x, y) * self.second(x, y)

    @override
    def stretched(self, unit: Float[Array, ""] | Float[Array, "D"]) -> Kernel:
        return Product(self.first.stretched(unit), self.second.stretched(unit))

    @override
    def scaled(self, variance: Float[Array, ""]) -> Kernel:
        return Product(self.first.scaled(variance), self.second)


def _squared_distance(x, y, lengthscale) -> Scalar:
    if lengthscale.size not in (1, x.size):
        raise ValueError(
            f"lengthscale: got {lengthscale.size} numbers; allowed: 1, or one for each dimension: {x.size}"
        )
    # A sum over a short last axis is slow on a CPU; unrolled, it is elementwise arithmetic over all pairs.
    # Coordinates are subtracted apart, since XLA does not vectorise an exponential of slices of one array.
    if x.size <= 8:
        scale = jnp.broadcast_to(lengthscale, x.shape)
        squares = [((x[i] - y[i]) / scale[i]) ** 2 for i in range(x.size)]
        return functools.reduce(operator.add, squares)
    scaled = (x - y) / lengthscale
    return jnp.sum(scaled * scaled)


def _distance(x, y, lengthscale) -> Scalar:
    # At an infinite distance, a polynomial times an exponential would be infinity times 0.
    squared = jnp.minimum(_squared_distance(x, y, lengthscale), FAR**2)
    # The gradient of sqrt at 0 is infinite; for points that coincide it is defined as 0 instead.
    is_positive = squared > 0.0
    return jnp.where(is_positive, jnp.sqrt(jnp.where(is_positive, squared, 1.0)), 0.0)
