"""Cholesky factors of small matrices in MJX, in elementwise arithmetic."""

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp

from bojax.numerics.linalg import guarded_cholesky, matmul

_MOST_ROWS = 16
"""Largest number of rows that are factorised in elementwise arithmetic."""

_replacing = threading.Lock()


@contextlib.contextmanager
def small_factors() -> Iterator[None]:
    """Replace `cho_factor` and `cho_solve` of JAX while MJX is traced; nothing is replaced on a CPU.

    MJX factorises the inertia matrix and, in every iteration of its Newton solver, the Hessian. Both have as
    many rows as the robot has degrees of freedom. On a GPU, every call of the library launches several
    kernels, while XLA fuses the elementwise arithmetic of all lanes into a few.

    The factor that is handed from one function to the other is the inverse of the lower Cholesky factor.
    """
    if jax.default_backend() == "cpu":
        yield
        return
    linalg: Any = jax.scipy.linalg
    with _replacing:
        library_factor, library_solve = linalg.cho_factor, linalg.cho_solve

        def factor(a: jax.Array) -> tuple[jax.Array, bool]:
            if len(a) > _MOST_ROWS:
                return library_factor(a)
            return guarded_cholesky(a, jnp.zeros(len(a), a.dtype))[1], False

        def solve(factor: tuple[jax.Array, bool], b: jax.Array) -> jax.Array:
            inverse, _ = factor
            if len(inverse) > _MOST_ROWS:
                return library_solve(factor, b)
            return matmul(inverse.T, matmul(inverse, b))

        linalg.cho_factor, linalg.cho_solve = factor, solve
        try:
            yield
        finally:
            linalg.cho_factor, linalg.cho_solve = library_factor, library_solve
