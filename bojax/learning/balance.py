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
    # One lot says which of those that are exactly the best: drawing one for each would take longer.
    rank = jnp.cumsum(scores == jnp.max(scores), dtype=jnp.int32)
    chosen = (jax.random.uniform(key, (), scores.dtype) * rank[-1].astype(scores.dtype)).astype(jnp.int32)
    return jnp.argmax(rank > chosen).astype(jnp.int32)
