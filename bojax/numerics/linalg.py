"""Small dense linear algebra with one policy for precision: float products never run in TF32."""

import jax.numpy as jnp
from jax.lax import Precision
from jaxtyping import Array, Float

HIGHEST = Precision.HIGHEST
"""Precision of every matrix product: TF32, JAX's default on NVIDIA GPUs, loses up to 4e-2 in a GP mean."""


def matmul(a: Float[Array, "*a"], b: Float[Array, "*b"]) -> Float[Array, "*c"]:
    """Matrix product at full precision."""
    return jnp.matmul(a, b, precision=HIGHEST)


def noise_floor(dtype) -> float:
    """Least noise variance, relative to the prior variance, with which a kernel matrix is factored.

    The jitter of every Gaussian process: 10^4 times the rounding error. In the worst case, a few points
    observed again and again without noise, an inverse Cholesky factor built row by row needs 10^3 for 100
    observations to be a factor at all (residual of L^-1 (K + noise I) L^-T: 0.25; with 10^4: 0.02).
    """
    return 1e4 * float(jnp.finfo(dtype).eps)


def solve_small(a: Float[Array, "N N"], b: Float[Array, "N K"]) -> Float[Array, "N K"]:
    """Solution of `a x = b` by Gauss-Jordan elimination with partial pivoting, unrolled.

    For N up to about eight: the elimination is elementwise arithmetic that XLA fuses into a few kernels
    over a batch, where a library call per matrix would cost a launch each on a GPU. A singular matrix
    gives infinities or NaN, as `jnp.linalg.solve` does.
    """
    n = a.shape[-1]
    rows = jnp.concatenate([a, b], axis=-1)
    index = jnp.arange(n)
    for k in range(n):
        column = jnp.where(index < k, -jnp.inf, jnp.abs(rows[:, k]))
        pivot = jnp.argmax(column)
        pivot_row = rows[pivot] / rows[pivot, k]
        # Swap rows k and pivot, then eliminate column k from every row but k.
        rows = jnp.where((index == pivot)[:, None], rows[k][None, :], rows)
        rows = jnp.where(
            (index == k)[:, None], pivot_row[None, :], rows - rows[:, k : k + 1] * pivot_row[None, :]
        )
    return rows[:, n:]
