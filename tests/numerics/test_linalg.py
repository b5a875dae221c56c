"""Elimination and factors against exact solutions in rational numbers, LAPACK and automatic derivatives."""

import subprocess
import sys
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.linalg import (
    eigh,
    guarded_cholesky,
    inverse_cholesky,
    matmul,
    row_sums,
    solve_large,
    solve_small,
)

SIZES = (1, 2, 3, 4, 5, 6)
solve = jax.jit(jax.vmap(solve_small))
inverse_factor = jax.jit(inverse_cholesky)
guarded_factor = jax.jit(guarded_cholesky)


def exact_solution(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solution of `a x = b` in rational arithmetic, rounded once at the end."""
    rows = [[Fraction(float(v)) for v in (*left, *right)] for left, right in zip(a, b, strict=True)]
    n = len(rows)
    for k in range(n):
        pivot = next(i for i in range(k, n) if rows[i][k])
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [v / rows[k][k] for v in rows[k]]
        for i in range(n):
            if i != k:
                factor = rows[i][k]
                rows[i] = [v - factor * w for v, w in zip(rows[i], rows[k], strict=True)]
    return np.array([[float(v) for v in row[n:]] for row in rows])


def relative_errors(xs: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Largest error of each solution, relative to its largest entry."""
    exact = np.stack([exact_solution(left, right) for left, right in zip(a, b, strict=True)])
    return np.abs(xs - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))


@pytest.mark.parametrize("n", [65, 512, 513, 1100])
def test_an_inverse_factor_of_any_size_is_that_of_numpy(n):
    rng = np.random.default_rng(n)
    half = rng.normal(size=(n, n))
    a = half @ half.T / n + np.eye(n)
    exact = np.linalg.inv(np.linalg.cholesky(a))
    assert np.abs(np.asarray(inverse_factor(a)) - exact).max() < 1e-13


@pytest.mark.parametrize("n", SIZES)
def test_solves_random_systems(n):
    rng = np.random.default_rng(n)
    a, b = rng.normal(size=(100, n, n)), rng.normal(size=(100, n, 3))
    x = np.asarray(solve(a, b))
    error = np.abs(x - np.linalg.solve(a, b)).max(axis=(1, 2)) / np.abs(x).max(axis=(1, 2))
    assert np.all(error <= 1e-15 * n * np.linalg.cond(a))


@pytest.mark.parametrize("n", [2, 4, 6])
@pytest.mark.parametrize("scaled", ["rows", "columns"])
def test_is_as_accurate_as_lapack_on_badly_scaled_systems(n, scaled):
    rng = np.random.default_rng(n)
    a, b = rng.normal(size=(50, n, n)), rng.normal(size=(50, n, 2))
    scale = 10.0 ** rng.uniform(-6.0, 6.0, size=(50, n))
    if scaled == "rows":
        a, b = a * scale[:, :, None], b * scale[:, :, None]
    else:
        a = a * scale[:, None, :]
    ours = relative_errors(np.asarray(solve(a, b)), a, b)
    lapack = relative_errors(np.linalg.solve(a, b), a, b)
    assert np.median(ours) <= 3.0 * np.median(lapack)
    assert np.all(ours <= 100.0 * lapack + 1e-14)


@pytest.mark.parametrize("n", SIZES[1:])
def test_exchanges_rows_where_the_diagonal_vanishes(n):
    # A cyclic permutation: without pivoting the first division is by zero.
    rng = np.random.default_rng(n)
    a = np.roll(np.diag(rng.uniform(1.0, 2.0, n)), 1, axis=0)
    b = rng.normal(size=(n, 2))
    np.testing.assert_allclose(solve(a[None], b[None])[0], np.linalg.solve(a, b), rtol=1e-15)


@pytest.mark.parametrize("left, right", [((4, 3), (3, 5)), ((3,), (3, 5)), ((4, 3), (3,)), ((3,), (3,))])
def test_products_keep_full_precision(left, right):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=left).astype(np.float32), rng.normal(size=right).astype(np.float32)
    exact = a.astype(np.float64) @ b.astype(np.float64)
    np.testing.assert_allclose(matmul(jnp.asarray(a), jnp.asarray(b)), exact, atol=1e-6)
    # A CPU has no lower precision, so the test reads the precision requested of an accelerator.
    assert "HIGHEST" in jax.jit(matmul).lower(a, b).as_text()


def covariance_matrix(n: int, seed: int = 0) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(n, n))
    return root @ root.T + np.eye(n)


@pytest.mark.parametrize("n", [1, 2, 7, 30])
def test_inverse_factors_invert_the_factor(n):
    a = covariance_matrix(n)
    expected = np.linalg.inv(np.linalg.cholesky(a))
    np.testing.assert_allclose(inverse_factor(a), expected, atol=1e-13)
    np.testing.assert_allclose(guarded_factor(a, np.ones(n))[1], expected, atol=1e-13)


def test_the_inverse_factor_has_the_derivatives_of_its_parts():
    a, direction = jnp.asarray(covariance_matrix(6)), jnp.asarray(covariance_matrix(6, seed=1))

    def by_parts(a):
        identity = jnp.eye(6)
        return jax.scipy.linalg.solve_triangular(jnp.linalg.cholesky(a), identity, lower=True)

    def derivatives(function):
        def along(t):
            return jnp.sum(function(a + t * direction) ** 3)

        tangent = jax.jvp(function, (a,), (direction,))[1]
        return tangent, jax.grad(along)(0.1), jax.grad(jax.grad(along))(0.1)

    ours, theirs = (jax.jit(lambda f=f: derivatives(f))() for f in (inverse_cholesky, by_parts))
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-13)


def test_pivots_stay_at_the_least_noise_where_rounding_makes_a_matrix_indefinite():
    # A matrix of ones with noise 1e-12, whose last diagonal entry rounding has reduced by 2e-12.
    noise = np.full((3,), 1e-12)
    a = np.ones((3, 3)) + np.diag(noise) - np.diag([0.0, 0.0, 2e-12])
    assert not np.all(np.isfinite(inverse_factor(a)))
    inverse = np.asarray(guarded_factor(a, noise)[1])
    assert np.all(np.isfinite(inverse))
    np.testing.assert_allclose(np.diag(inverse)[2], 1e6, rtol=1e-3)


def test_a_row_apart_from_the_others_stays_apart():
    a = np.eye(5)
    a[np.ix_([0, 2, 4], [0, 2, 4])] = covariance_matrix(3)
    inverse = guarded_factor(a, np.zeros(5))[1]
    np.testing.assert_array_equal(inverse[1], np.eye(5)[1])
    np.testing.assert_array_equal(inverse[:, 3], np.eye(5)[3])


def test_eigenvectors_put_the_matrix_together_again():
    a = np.stack([covariance_matrix(4, seed) for seed in range(3)])
    values, vectors = jax.jit(jax.vmap(eigh))(jnp.asarray(a))
    assert np.all(np.diff(values, axis=1) > 0.0)
    again = np.einsum("bij,bj,bkj->bik", vectors, values, vectors)
    np.testing.assert_allclose(again, a, atol=1e-12)


STANDSTILL = """
import jax
import jax.numpy as jnp
from bojax.numerics.linalg import inverse_cholesky

a = jnp.eye(24) + jnp.ones((4, 1000, 24, 24))
factors = jax.jit(lambda *a: [jax.vmap(inverse_cholesky)(one) for one in a])
for _ in range(30):
    jax.block_until_ready(factors(*a))
"""


def test_batches_at_once_do_not_bring_the_threads_to_a_standstill():
    # With LAPACK called on whole batches, this never ends on a CPU of two cores.
    subprocess.run([sys.executable, "-c", STANDSTILL], check=True, timeout=300)


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
@pytest.mark.parametrize("shape", [(1, 1), (64, 500), (3, 0)])
def test_sums_of_rows_are_those_of_numpy(backend, shape, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    rows = np.random.default_rng(0).normal(size=(2, *shape)).astype(np.float32)
    found = np.array([row_sums(jnp.asarray(rows[0])), jax.vmap(row_sums)(jnp.asarray(rows))[1]])
    exact, size = rows.sum(axis=2, dtype=np.float64), np.abs(rows).sum(axis=2, dtype=np.float64)
    assert found.dtype == np.float32 and (np.abs(found - exact) <= shape[1] * 2.0**-24 * size).all()


@pytest.mark.parametrize(("backend", "n"), [("cpu", 150), *(("gpu", n) for n in (1, 64, 65, 150, 321))])
def test_solutions_of_a_batch_of_large_systems_are_those_of_numpy(backend, n, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    rng = np.random.default_rng(0)
    factors, b = rng.normal(size=(3, 3 * n, n)), rng.normal(size=(3, n, 2))
    matrix = 1e-4 * np.eye(n) + factors.swapaxes(1, 2) @ (factors - 0.9 * rng.permutation(factors, axis=1))
    found = jax.jit(jax.vmap(solve_large))(jnp.asarray(matrix), jnp.asarray(b))
    expected = np.linalg.solve(matrix, b)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
