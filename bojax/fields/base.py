"""The protocol of a field: a scalar function of the plane."""

import abc

import equinox as eqx
import jax
from jaxtyping import Array, Float, Scalar


class Field(eqx.Module):
    """An environmental variable as a function of the position in metres."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "2"]) -> Scalar:
        """Value at a point."""

    def values(self, xs: Float[Array, "N 2"]) -> Float[Array, "N"]:
        """Values at many points."""
        return jax.vmap(self)(xs)

    def gradients(self, xs: Float[Array, "N 2"]) -> Float[Array, "N 2"]:
        """Gradients at many points, in units of the value per metre."""
        return jax.vmap(jax.grad(self))(xs)
