"""Standardisation of observed values for a Gaussian process of mean 0 and variance 1."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def standardise(values: Float[Array, "N"], exists: Bool[Array, "N"]) -> Float[Array, "N"]:
    """Scale values to mean 0 and variance 1; 0 if all are equal, and where `exists` is false."""
    values = jnp.where(exists, values, 0.0)
    # Without this scaling, squares of large values would overflow.
    largest = jnp.max(jnp.abs(values), initial=0.0)
    values = values / jnp.where(largest > 0.0, largest, 1.0)
    number = jnp.maximum(jnp.sum(exists), 1).astype(values.dtype)
    centred = jnp.where(exists, values - jnp.sum(values) / number, 0.0)
    std = jnp.sqrt(jnp.sum(centred**2) / number)
    # Equal values differ from their mean by rounding only.
    is_constant = std <= 100.0 * jnp.finfo(values.dtype).eps
    return jnp.where(is_constant, 0.0, centred / jnp.where(is_constant, 1.0, std))
