"""Standardisation of observed values for a Gaussian process of prior mean 0 and prior variance 1."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def standardise(values: Float[Array, "N"], exists: Bool[Array, "N"]) -> Float[Array, "N"]:
    """Scale values to mean 0 and variance 1; 0 if all are equal, and where `exists` is false."""
    return _standardised(values, exists)[0]


def centre_and_unit(
    values: Float[Array, "N"], exists: Bool[Array, "N"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The mean that `standardise` subtracts and the standard deviation that it divides by.

    Equal values are divided by 1. Without values, the mean is 0.
    """
    _, centre, unit = _standardised(values, exists)
    return centre, unit


def _standardised(
    values: Float[Array, "N"], exists: Bool[Array, "N"]
) -> tuple[Float[Array, "N"], Float[Array, ""], Float[Array, ""]]:
    values = jnp.where(exists, values, 0.0)
    # Without this scaling, squares of large values would overflow.
    largest = jnp.max(jnp.abs(values), initial=0.0)
    largest = jnp.where(largest > 0.0, largest, 1.0)
    values = values / largest
    number = jnp.maximum(jnp.sum(exists), 1).astype(values.dtype)
    mean = jnp.sum(values) / number
    centred = jnp.where(exists, values - mean, 0.0)
    std = jnp.sqrt(jnp.sum(centred**2) / number)
    # Equal values differ from their mean by rounding only.
    is_constant = std <= 100.0 * jnp.finfo(values.dtype).eps
    standardised = jnp.where(is_constant, 0.0, centred / jnp.where(is_constant, 1.0, std))
    return standardised, largest * mean, jnp.where(is_constant, 1.0, largest * std)
