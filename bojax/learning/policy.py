"""The policy argmax Q + kappa U (5.10), and the rule that breaks its ties."""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

Ties = Literal["random", "first"]
"""How ties between the best actions are broken."""


def best_action(key: Key[Array, ""], scores: Float[Array, "A"], ties: Ties = "random") -> Int[Array, ""]:
    """Index of an action of the largest score: Q + kappa U, or Q alone."""
    if ties == "first":
        return jnp.argmax(scores).astype(jnp.int32)
    return random_argmax(jax.random.uniform(key, (), scores.dtype), scores)


def random_argmax(draw: Float[Array, ""], scores: Float[Array, "A"]) -> Int[Array, ""]:
    """Index of a largest score, where ties are broken by a uniform draw in [0, 1).

    A draw of 0 selects the first of the tied scores.
    """
    # Each of the tied scores gets a rank from 1; the one that the draw selects is the first whose rank
    # exceeds it. The bound guards against a product that rounds up to the number of ties.
    rank = jnp.cumsum(scores == jnp.max(scores), dtype=jnp.int32)
    chosen = (draw * rank[-1].astype(draw.dtype)).astype(jnp.int32)
    return jnp.argmax(rank > jnp.minimum(chosen, rank[-1] - 1)).astype(jnp.int32)
