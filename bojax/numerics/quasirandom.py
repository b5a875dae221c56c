"""Low-discrepancy points: a Kronecker sequence with a random shift, for candidates of an acquisition."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key


def generalised_golden_ratio(num_dims: int) -> float:
    """The real root above 1 of x^(d+1) = x + 1: the golden ratio for one dimension."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (num_dims + 1))
    return root


def shifted_kronecker(key: Key[Array, ""], num_points: int, num_dims: int, dtype) -> Float[Array, "N D"]:
    """`num_points` points that fill [-1, 1]^D evenly, shifted at random modulo the box.

    The additive recurrence frac(s + i alpha) with alpha_j = g^-j, where g is the generalised golden ratio
    (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018), and a Cranley-Patterson
    shift s: each point alone is uniform, so one of them is also a fair random draw.
    """
    ratio = generalised_golden_ratio(num_dims)
    step = jnp.asarray([ratio ** -(j + 1) for j in range(num_dims)], dtype)
    shift = jax.random.uniform(key, (num_dims,), dtype)
    index = jnp.arange(num_points, dtype=dtype)
    return 2.0 * jnp.mod(shift[None, :] + index[:, None] * step[None, :], 1.0) - 1.0
