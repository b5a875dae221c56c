"""Prior mean functions of Gaussian processes, written for one point and batched outside."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Scalar
from typing_extensions import override

from bojax.models.checks import as_numbers
from bojax.numerics.linalg import matmul


class Mean(eqx.Module):
    """A prior mean function m(x)."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "D"]) -> Scalar:
        """The prior mean at a point."""


class ZeroMean(Mean):
    """The zero mean, m(x) = 0.

    Settings: `bojax.models.settings.ZeroMean`.
    """

    @override
    def __call__(self, x: Float[Array, "D"]) -> Scalar:
        return jnp.zeros((), x.dtype)


class ConstantMean(Mean):
    """A constant mean, m(x) = value.

    Settings: `bojax.models.settings.ConstantMean`.
    """

    value: Float[Array, ""] = eqx.field(converter=as_numbers("value"))

    @override
    def __call__(self, x: Float[Array, "D"]) -> Scalar:
        return self.value


class LinearMean(Mean):
    """A linear mean, m(x) = weights' x + bias.

    Settings: `bojax.models.settings.LinearMean`.
    """

    weights: Float[Array, "D"] = eqx.field(converter=as_numbers("weights"))
    bias: Float[Array, ""] = eqx.field(converter=as_numbers("bias"))

    @override
    def __call__(self, x: Float[Array, "D"]) -> Scalar:
        return matmul(self.weights, x) + self.bias
