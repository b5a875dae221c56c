"""Arrays of tests."""

import jax.numpy as jnp


def f64(value):
    """An array of 64-bit numbers."""
    return jnp.asarray(value, jnp.float64)
