"""The policy argmax Q + kappa U (5.10), with the tie rule in one place."""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

Ties = Literal["random", "first"]
"""Which of several best actions is taken."""


def best_action(
    key: Key[Array, ""],
    q: Float[Array, "A"],
    u: Float[Array, "A"],
    kappa: Float[Array, ""],
    ties: Ties = "random",
) -> Int[Array, ""]:
    """Index of the action that maximises Q + kappa U."""
    scores = q + kappa * u
    if ties == "first":
        return jnp.argmax(scores).astype(jnp.int32)
    # Only the best ones take part: a uniform draw among them, exact ties alone.
    lots = jax.random.uniform(key, scores.shape, scores.dtype)
    return jnp.argmax(jnp.where(scores == jnp.max(scores), lots, -1.0)).astype(jnp.int32)
