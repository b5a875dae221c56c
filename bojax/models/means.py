"""Prior means of Gaussian processes, written for one point and batched outside."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Scalar

from bojax.models.checks import as_numbers
from bojax.numerics.linalg import matmul


class Mean(eqx.Module):
    """The expected value m(x) before any observation."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "D"]) -> Scalar:
        """Expected value at a point."""


class ZeroMean(Mean):
    """m(x) = 0.

    Settings: `bojax.models.settings.ZeroMean`.
    """

    def __call__(self, x: Float[Array, "D"]) -> Scalar:
        """See `Mean`."""
        return jnp.zeros((), x.dtype)


class ConstantMean(Mean):
    """The same value everywhere.

    Settings: `bojax.models.settings.ConstantMean`.
    """

    value: Float[Array, ""] = eqx.field(converter=as_numbers("value"))

    def __call__(self, x: Float[Array, "D"]) -> Scalar:
        """See `Mean`."""
        del x
        return self.value


class LinearMean(Mean):
    """m(x) = weights' x + bias.

    Settings: `bojax.models.settings.LinearMean`.
    """

    weights: Float[Array, "D"] = eqx.field(converter=as_numbers("weights"))
    bias: Float[Array, ""] = eqx.field(converter=as_numbers("bias"))

    def __call__(self, x: Float[Array, "D"]) -> Scalar:
        """See `Mean`."""
        return matmul(self.weights, x) + self.bias
