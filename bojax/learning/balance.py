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
    return one_of_the_best(jax.random.uniform(key, (), scores.dtype), scores)


def one_of_the_best(lot: Float[Array, ""], scores: Float[Array, "A"]) -> Int[Array, ""]:
    """Index of one of those scores that are exactly the greatest: which one is up to a lot in [0, 1).

    A lot of 0 takes the first, and a uniform lot each of them alike.
    """
    rank = jnp.cumsum(scores == jnp.max(scores), dtype=jnp.int32)
    chosen = (lot * rank[-1].astype(lot.dtype)).astype(jnp.int32)
    return jnp.argmax(rank > jnp.minimum(chosen, rank[-1] - 1)).astype(jnp.int32)
