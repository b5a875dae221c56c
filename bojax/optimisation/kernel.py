"""A kernel over positions of a space, which sees the values that positions stand for."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Scalar
from typing_extensions import override

from bojax.models.kernels import Kernel, Matern52
from bojax.optimisation.space import Axis, Choice, Range


def mixed_matern52(lengthscale: Float[Array, "A"], axes: tuple[Axis, ...]) -> Kernel:
    """A Matern 5/2 kernel of the values of numbers, integers and choices, with a lengthscale for each axis.

    Positions are rounded inside the kernel, so that the covariance is constant where the value is, and the
    posterior of all positions of one value is the same (Garrido-Merchan and Hernandez-Lobato, "Dealing with
    categorical and integer-valued variables in Bayesian optimization with Gaussian processes",
    Neurocomputing 380, 2020). Two choices are as far apart as the two ends of a range.

    Args:
        lengthscale: In units of half a range, one for each axis.
        axes: The axes, whose boxes positions fill in [-1, 1].
    """
    return _MixedMatern52(lengthscale, tuple(map(_without_names, axes)))


def _without_names(axis: Axis) -> Axis:
    """The axis as far as the covariance depends on it: other spaces of this form share a compiled program."""
    if isinstance(axis, Choice):
        return Choice("", tuple(range(axis.width)))
    if axis.is_integer:
        return dataclasses.replace(axis, key="")
    return Range("", -1.0, 1.0, is_log=False, is_integer=False)


class _MixedMatern52(Kernel):
    lengthscale: Float[Array, "A"]
    axes: tuple[Axis, ...] = eqx.field(static=True)

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Scalar:
        widths = [axis.width for axis in self.axes]
        scales = jnp.repeat(self.lengthscale, jnp.asarray(widths), total_repeat_length=sum(widths))
        return Matern52(scales)(self._rounded(x), self._rounded(y))

    def _rounded(self, x: Float[Array, "D"]) -> Float[Array, "D"]:
        parts, first = [], 0
        for axis in self.axes:
            part = x[first : first + axis.width]
            parts.append(_one_hot(part) if isinstance(axis, Choice) else _whole(axis, part))
            first += axis.width
        return jnp.concatenate(parts)


def _one_hot(part: Float[Array, "K"]) -> Float[Array, "K"]:
    return 2.0**0.5 * jax.nn.one_hot(jnp.argmax(part), part.shape[0], dtype=part.dtype)


def _whole(axis: Range, part: Float[Array, "1"]) -> Float[Array, "1"]:
    """The position of the integer to which a position is rounded; that of a number is the position itself."""
    if not axis.is_integer:
        return part
    low, high = axis.box
    position = low + 0.5 * (part + 1.0) * (high - low)
    value = 10.0**position if axis.is_log else position
    value = jnp.clip(jnp.floor(value + 0.5), axis.low, axis.high)
    # Rounding has no gradient, and the one of the logarithm need not be computed.
    value = jax.lax.stop_gradient(value)
    return 2.0 * ((jnp.log10(value) if axis.is_log else value) - low) / (high - low) - 1.0
