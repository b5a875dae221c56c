"""The protocol of a field: a scalar function of the plane."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Scalar

from bojax.numerics.trial import Misfit, trial


class Field(eqx.Module):
    """An environmental variable as a function of the position in metres."""

    def __check_init__(self):
        """Call a user's field at a point, or raise ValueError."""
        trial(self, _check_value)

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "2"]) -> Scalar:
        """Value at a point."""

    def values(self, xs: Float[Array, "N 2"]) -> Float[Array, "N"]:
        """Values at many points."""
        return jax.vmap(self)(xs)

    def gradients(self, xs: Float[Array, "N 2"]) -> Float[Array, "N 2"]:
        """Gradients at many points, in units of the value per metre."""
        return jax.vmap(jax.grad(self))(xs)


def _check_value(field: Field) -> None:
    value = field(jnp.zeros(2))
    if jnp.shape(value) != ():
        raise Misfit(f"the value at a point has shape {jnp.shape(value)}; allowed: one number")
