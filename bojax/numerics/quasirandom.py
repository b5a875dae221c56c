"""Quasi-random points: a shifted Kronecker sequence for candidates, a scrambled Halton one for integrals."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from bojax.numerics.linalg import matmul


def generalised_golden_ratio(num_dims: int) -> float:
    """The real root above 1 of x^(d+1) = x + 1; for d = 1, the golden ratio."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (num_dims + 1))
    return root


def shifted_kronecker(key: Key[Array, ""], num_points: int, num_dims: int, dtype) -> Float[Array, "N D"]:
    """`num_points` points that fill [-1, 1]^D evenly, shifted at random modulo the box.

    The sequence is the additive recurrence frac(s + i alpha) with alpha_j = g^-j, where g is the generalised
    golden ratio (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018). With the
    Cranley-Patterson shift s, each point is uniformly distributed.
    """
    ratio = generalised_golden_ratio(num_dims)
    step = jnp.asarray([ratio ** -(j + 1) for j in range(num_dims)], dtype)
    shift = jax.random.uniform(key, (num_dims,), dtype)
    index = jnp.arange(num_points, dtype=dtype)
    return 2.0 * jnp.mod(shift[None, :] + index[:, None] * step[None, :], 1.0) - 1.0


def scrambled_halton(key: Key[Array, ""], num_points: int, num_dims: int, dtype) -> Float[Array, "N D"]:
    """`num_points` points that fill the open cube (0, 1)^D evenly; each point is uniformly distributed.

    The digits at every place are permuted at random (Owen, "A randomized Halton algorithm in R", 2017).
    """
    # The j-th coordinate of Halton's sequence reverses the digits of the index in the j-th prime base.
    # Permutations break the correlation between the coordinates of large bases, which are otherwise almost
    # proportional to each other. Places that no index reaches hold the same permuted zeros in all points: a
    # uniform draw replaces them.
    levels = [
        (dim, base, base**k)
        for dim, base in enumerate(_first_primes(num_dims))
        for k in range(64)
        if k == 0 or base**k < num_points
    ]
    dim, base, place = np.asarray(levels).T
    digits = np.arange(num_points)[None, :] // place[:, None] % base[:, None]
    weights = np.where(np.arange(num_dims)[:, None] == dim, 1.0 / (base * place), 0.0)
    permute, shift = jax.random.split(key)
    # A single sort draws the permutations of all places, since sorts are slow to compile.
    order = jax.random.uniform(permute, (len(base), max(base)), dtype)
    permutations = jnp.argsort(jnp.where(np.arange(max(base)) < base[:, None], order, 2.0), axis=1)
    permuted = jnp.take_along_axis(permutations, digits, axis=1).astype(dtype)
    beyond = jnp.asarray(np.where(weights > 0.0, weights, 1.0).min(axis=1), dtype)
    rest = beyond * jax.random.uniform(shift, (num_dims,), dtype)
    return inside_the_cube((matmul(jnp.asarray(weights, dtype), permuted) + rest[:, None]).T)


def inside_the_cube(points: Float[Array, "N D"]) -> Float[Array, "N D"]:
    """Move points of the closed unit cube off its faces by half a rounding error, for finite quantiles."""
    margin = 0.5 * float(jnp.finfo(points.dtype).eps)
    return jnp.clip(points, margin, 1.0 - margin)


def _first_primes(number: int) -> list[int]:
    primes: list[int] = []
    candidate = 2
    while len(primes) < number:
        if all(candidate % prime for prime in primes):
            primes.append(candidate)
        candidate += 1
    return primes
