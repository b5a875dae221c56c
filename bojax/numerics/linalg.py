"""Small dense linear algebra, with one policy for precision and one for jitter."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.lax import DotAlgorithmPreset, Precision
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

from bojax.numerics.loops import is_unrolled, short_loop

HIGHEST = Precision.HIGHEST
"""Precision of every matrix product. TF32, JAX's default on NVIDIA GPUs, errs by up to 4e-2 in a GP mean."""

full_precision = jax.default_matmul_precision("highest")
"""Decorator of a function all of whose products, such as `a @ b`, are at full precision."""

BLOCK = 8  # number of columns that a step of `guarded_cholesky` eliminates on an accelerator


def matmul(a: Float[Array, "*a"], b: Float[Array, "*b"]) -> Float[Array, "*c"]:
    """Matrix product at full precision."""
    return jnp.matmul(a, b, precision=HIGHEST)


def matmul_on_tensor_cores(a: Float[Array, "*a"], b: Float[Array, "*b"]) -> Float[Array, "*c"]:
    """Product at full precision, for large batches of matrices or large matrices in float32."""
    # On NVIDIA GPUs, the product of two float32 matrices is the sum of three products in TF32, which tensor
    # cores compute. For 11 rows times 500 x 500 matrices on an H200, its largest error is 2e-7, with `matmul`
    # 7e-7; a batch of 200 takes 91 us instead of 121. With fewer kernels to compare, XLA compiles a refit of
    # EMU-Q in 5 s instead of 9.
    if a.dtype != jnp.float32 or b.dtype != jnp.float32 or min(a.ndim, b.ndim) < 2:
        return matmul(a, b)
    return jax.lax.platform_dependent(a, b, cuda=_three_products, default=matmul)


def _three_products(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision=DotAlgorithmPreset.TF32_TF32_F32_X3)


def row_sums(a: Float[Array, "N M"]) -> Float[Array, "N"]:
    """The sum of every row."""
    # On a CPU a product with ones, which adds several numbers of a row at once. For 64 rows of 500 products,
    # XLA's own sum takes 13 us in float32, 26 us in float64, and 87 us in float32 in a batch of one lane;
    # this takes 6, 11 and 6 us. On a GPU, the sum is part of the kernel that computes the numbers.
    if jax.default_backend() != "cpu":
        return jnp.sum(a, axis=1)
    return matmul(a, jnp.ones(a.shape[1], a.dtype))


def noise_floor(dtype) -> float:
    """Minimum noise variance of a Gaussian process, relative to the prior variance; its only jitter.

    It is 1.8e-9 in float64 and 1.2e-3 in float32.
    """
    # The inverse Cholesky factor L^-1 is built row by row. At the noise variance r, its entries reach r^-1/2,
    # and the rounding error of a new row, relative to its pivot, is proportional to eps r^-3/2. This error
    # enters the next row; once it reaches 1, the factor grows without bound and overflows. The floor is
    # therefore proportional to eps^(2/3). Measured at the floor with a smooth kernel and points along paths,
    # max |L^-1 (K + r I) L^-T - I| is 2e-3 for 200 observations and 5e-3 for 600, in both precisions. In
    # float64, 1e-11 overflows at 200 observations and 1e-10 at 600.
    return 50.0 * float(jnp.finfo(dtype).eps) ** (2.0 / 3.0)


def covariance_floor(dtype) -> float:
    """Minimum noise variance of a Bayesian linear regression, relative to the prior variance of the value."""
    # The covariance matrix is stored, and every observation subtracts from it. Each entry has a rounding
    # error in proportion to the prior variance; at the floor, this error is 1e-4 of the noise variance.
    return 1e4 * float(jnp.finfo(dtype).eps)


def one_by_one_on_cpu(function: Callable[[Array], Any]) -> Callable[[Array], Any]:
    """Make a function of one matrix that calls LAPACK process a batch sequentially on a CPU."""
    # Given a whole batch, jaxlib (0.10) distributes it over its threads and blocks one of them until all are
    # done. With as many concurrent calls as cores, every thread is blocked: the program deadlocks.
    in_turn = jax.custom_batching.sequential_vmap(function)

    def call(a: Array) -> Any:
        return jax.lax.platform_dependent(a, cpu=in_turn, default=function)

    return call


@one_by_one_on_cpu
def _inverse_factor(a: Float[Array, "N N"]) -> Float[Array, "N N"]:
    return _inverse_triangular(jnp.linalg.cholesky(a, symmetrize_input=False))


def _inverse_triangular(factor: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """L^-1 of a lower triangular matrix."""
    # By recursive halving down to 64 rows: the inverse of L = [[A, 0], [B, C]] is [[A^-1, 0], [-C^-1 B A^-1,
    # C^-1]]. For 200 rows on a CPU, LAPACK's triangular solve with an identity matrix takes twice as long.
    n = factor.shape[0]
    if n <= 64:
        return solve_triangular(factor, jnp.eye(n, dtype=factor.dtype), lower=True)
    if n > 512:
        return _inverse_of_many_rows(factor)
    half = n // 2
    return _joined(
        _inverse_triangular(factor[:half, :half]),
        _inverse_triangular(factor[half:, half:]),
        factor[half:, :half],
    )


def _joined(first: Float[Array, "A A"], last: Float[Array, "B B"], below: Float[Array, "B A"]) -> Array:
    """L^-1, given the inverses of its diagonal blocks and the block below."""
    below = -matmul(last, matmul(below, first))
    return jnp.block([[first, jnp.zeros_like(below.T)], [below, last]])


def _inverse_of_many_rows(factor: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """The halving of `_inverse_triangular` from below: blocks of equal size are joined in pairs."""
    # A program of the recursion itself grows with the number of rows: 5,000 compile for 15 s.
    n = factor.shape[0]
    num_blocks = 1 << (-(-n // 512) - 1).bit_length()
    size = -(-n // num_blocks)
    padding = num_blocks * size - n
    padded = jax.scipy.linalg.block_diag(factor, jnp.eye(padding, dtype=factor.dtype))
    inverses = jax.lax.map(_inverse_triangular, _blocks(padded, size, 0, 1))
    while size < len(padded):
        inverses = jax.vmap(_joined)(inverses[::2], inverses[1::2], _blocks(padded, size, 1, 2))
        size *= 2
    return inverses[0, :n, :n]


def _blocks(matrix: Float[Array, "N N"], size: int, below: int, step: int) -> Float[Array, "K size size"]:
    """Every `step`-th block of columns, in the rows that are `below` blocks under the diagonal."""
    starts = range(0, len(matrix), step * size)
    return jnp.stack([matrix[at + below * size :, at:][:size, :size] for at in starts])


@jax.custom_jvp
def inverse_cholesky(a: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """L^-1 of a symmetric positive definite matrix `a = L L'`; NaN if `a` is not positive definite."""
    return _inverse_factor(a)


@inverse_cholesky.defjvp
def _inverse_cholesky_jvp(primals, tangents):
    # d(L^-1) = -Phi(L^-1 da L^-T) L^-1, where Phi takes the lower triangle with half the diagonal: matrix
    # products only, three times as fast as the derivatives of a Cholesky factor and a triangular solve.
    inverse, (tangent,) = inverse_cholesky(*primals), tangents
    both = matmul(matmul(inverse, tangent), inverse.T)
    half = jnp.tril(both) - 0.5 * jnp.diag(jnp.diagonal(both))
    return inverse, -matmul(half, inverse)


def guarded_cholesky(
    a: Float[Array, "N N"], least: Float[Array, "N"], num: int | None = None
) -> tuple[Float[Array, "N num"], Float[Array, "num num"]]:
    """The first columns of the Cholesky factor of a covariance matrix, and the inverse of its leading block.

    In exact arithmetic, no squared pivot is less than the noise variance on the diagonal; a squared pivot
    that rounding takes below this value is raised to it.

    Args:
        a: Covariance matrix, with the noise variances on its diagonal.
        least: Noise variance of each row.
        num: Number of columns; all by default.
    """
    # Gaussian elimination of [a | I] in elementwise arithmetic: LAPACK's factor is NaN if rounding makes the
    # matrix indefinite, as in a difference of two nearly equal matrices. Step k zeroes column k of `a` below
    # the diagonal and fills column k of the right half there, which is stored in its place. On an
    # accelerator, a step eliminates `BLOCK` columns: XLA makes about four kernels of a step, whatever the
    # number of its columns. For 16 columns of 24 rows, 38 kernels in the loop of a search become 9.
    num = a.shape[0] if num is None else num
    rows = a[:num]
    if is_unrolled(num):
        for first in range(0, num, BLOCK):
            rows = _eliminate(rows, least, first, min(BLOCK, num - first))
    elif num > 0:
        rows = jax.lax.fori_loop(0, num, lambda k, rows: _eliminate(rows, least, k, 1), rows)
    is_pivot = jnp.eye(num, dtype=bool)
    inverse = jnp.where(is_pivot, 1.0 / jnp.diagonal(rows)[:, None], rows[:, :num])
    return jnp.tril(rows.T), jnp.tril(inverse)


def _eliminate(
    rows: Float[Array, "num N"], least: Float[Array, "N"], first: int | Int[Array, ""], size: int
) -> Float[Array, "num N"]:
    """A step of `guarded_cholesky`: eliminate the `size` columns from `first` on."""
    # The Cholesky factor of the diagonal block, as scalars. Divisions in 64 bits are slow on a GPU, and those
    # of a block wait for each other: the inverse of a pivot is computed once.
    factor: list[list[Array]] = []
    inverse: list[Array] = []
    for p in range(size):
        factor.append([])
        for q in range(p + 1):
            rest = rows[first + q, first + p]
            for r in range(q):
                rest = rest - factor[p][r] * factor[q][r]
            if q == p:
                rest = jnp.sqrt(jnp.maximum(rest, least[first + p]))
                inverse.append(1.0 / rest)
            factor[p].append(rest if q == p else rest * inverse[q])

    # The rows of the block in [a | I], times the inverse of this factor.
    index = jnp.arange(rows.shape[1])
    is_own = (index >= first) & (index < first + size)
    scaled: list[Array] = []
    for p in range(size):
        rest = jnp.where(index == first + p, 1.0, jnp.where(is_own, 0.0, rows[first + p]))
        for q in range(p):
            rest = rest - factor[p][q] * scaled[q]
        scaled.append(rest * inverse[p])

    # As `a` is symmetric, the scaled rows also hold the factors of their subtraction from later rows.
    # A single column is scaled again: a CPU is four times as fast where it reads the factors along a column.
    num = rows.shape[0]
    factors = [row[:num] for row in scaled] if size > 1 else [rows[:, first] * inverse[0]]
    is_later = index >= first + size
    rows = jnp.where(is_later[:num, None] & is_own[None, :], 0.0, rows)
    for row, column in zip(scaled, factors, strict=True):
        rows = rows - jnp.where(is_later[:num], column, 0.0)[:, None] * row[None, :]
    for p, row in enumerate(scaled):
        for q in range(p, size):
            row = jnp.where(index == first + q, factor[q][p], row)
        rows = jnp.where((index[:num] == first + p)[:, None], row[None, :], rows)
    return rows


@one_by_one_on_cpu
def eigh(a: Float[Array, "N N"]) -> tuple[Float[Array, "N"], Float[Array, "N N"]]:
    """Eigenvalues of a symmetric matrix in ascending order, and its eigenvectors as columns."""
    values, vectors = jnp.linalg.eigh(a)
    return values, vectors


def solve_small(a: Float[Array, "N N"], b: Float[Array, "N K"]) -> Float[Array, "N K"]:
    """Solution of `a x = b` by Gauss-Jordan elimination with partial pivoting, for N up to about 8.

    A singular matrix gives infinities or NaN, as in `jnp.linalg.solve`.
    """
    # XLA fuses the elementwise arithmetic into a few kernels for a whole batch; a library call would launch a
    # kernel for each matrix on a GPU. Rows are exchanged and eliminated under masks, as the pivot differs
    # between lanes.
    n = a.shape[-1]
    index = jnp.arange(n)

    def eliminate(k, rows):
        column = jnp.where(index < k, -jnp.inf, jnp.abs(rows[:, k]))
        pivot = jnp.argmax(column)
        pivot_row = rows[pivot] / rows[pivot, k]
        # Swap rows k and pivot, then eliminate column k from every row but k.
        rows = jnp.where((index == pivot)[:, None], rows[k][None, :], rows)
        rest = rows - rows[:, k][:, None] * pivot_row[None, :]
        return jnp.where((index == k)[:, None], pivot_row[None, :], rest)

    return short_loop(n, eliminate, jnp.concatenate([a, b], axis=-1))[:, n:]


def solve_large(a: Float[Array, "N N"], b: Float[Array, "N K"]) -> Float[Array, "N K"]:
    """Solution of `a x = b` of any size, by LAPACK's LU factors on a CPU and by blocks elsewhere."""
    if jax.default_backend() == "cpu":
        return _solve_by_lapack(jnp.concatenate([a, b], axis=1))
    # A step of refinement, since the elimination by blocks hardly exchanges rows.
    solve = _eliminated_by_blocks(a)
    x = solve(b)
    return x + solve(b - matmul(a, x))


@one_by_one_on_cpu
def _solve_by_lapack(rows: Float[Array, "N C"]) -> Float[Array, "N K"]:
    """The solution of `a x = b`, given [a | b]."""
    return jnp.linalg.solve(rows[:, : len(rows)], rows[:, len(rows) :])


def _eliminated_by_blocks(a: Float[Array, "N N"]) -> Callable[[Float[Array, "N K"]], Float[Array, "N K"]]:
    """The solution of `a x = b` as a function of b, by Gaussian elimination of a block of columns at a time.

    Columns are exchanged within a block only: if the inverse of a leading part is much larger than the
    inverse of the matrix, digits are lost in proportion.
    """
    # Most of the work is matrix products, which a GPU computes for a whole batch at once. What remains of the
    # matrix shrinks from step to step, so that all steps read and write less than twice what the matrix
    # takes: unrolled, since shapes in a loop are fixed. In a loop that computed the inverse in place, 200
    # systems with 500 unknowns took 10.3 ms on an H200, and 45 took 4.0; this takes 5.6 and 2.8, with blocks
    # of 64 columns in place of 128 4.9 and 2.6, and cuSOLVER's LU factors 18.9 and 13.0.
    n, product = a.shape[0], matmul_on_tensor_cores
    block = min(n, 64 * -(-n // 320))  # five steps or fewer, since each is code of its own
    number = -(-n // block)
    padding = number * block - n
    # Rows and columns of the identity fill the last block.
    rest = jax.scipy.linalg.block_diag(a, jnp.eye(padding, dtype=a.dtype))
    steps = []
    for _ in range(number):
        # The inverse of the transposed block has the layout that LAPACK expects: no copy is needed.
        pivot = jnp.linalg.inv(rest[:block, :block].T).T
        right, below = product(pivot, rest[:block, block:]), rest[block:, :block]
        steps.append((pivot, right, below))
        rest = rest[block:, block:] - product(below, right)

    def solve(b: Float[Array, "N K"]) -> Float[Array, "N K"]:
        b = jnp.pad(b, ((0, padding), (0, 0)))
        parts = []
        for pivot, _, below in steps:
            parts.append(matmul(pivot, b[:block]))
            b = b[block:] - matmul(below, parts[-1])
        x = parts.pop()
        for part, (_, right, _) in zip(reversed(parts), reversed(steps[:-1]), strict=True):
            x = jnp.concatenate([part - matmul(right, x), x])
        return x[:n]

    return solve
