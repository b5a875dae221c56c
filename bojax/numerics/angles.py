"""Angles in radians, wrapped to one turn."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def wrap_to_pi(angle: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """The equivalent angle in [-pi, pi)."""
    return jnp.mod(angle + jnp.pi, 2.0 * jnp.pi) - jnp.pi


def wrap_to_2pi(angle: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """The equivalent angle in [0, 2 pi)."""
    return jnp.mod(angle, 2.0 * jnp.pi)
