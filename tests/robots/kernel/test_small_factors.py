"""Small Cholesky factors against SciPy; `test_simulator` compares MJX with them to C MuJoCo on a GPU."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from bojax.numerics.third_party import plain_jax
from bojax.robots.kernel.small_factors import small_factors


@pytest.mark.parametrize("rows", [1, 6, 11, 17])
def test_systems_are_solved_as_by_scipy(monkeypatch, rows):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    draws = np.random.default_rng(rows).normal(size=(5, rows, 2 * rows))
    matrices, b = draws @ draws.swapaxes(1, 2), draws[:, :, 0]

    def solution(a, b):
        factor = jax.scipy.linalg.cho_factor(a)
        return jax.scipy.linalg.cho_solve(factor, b)

    with plain_jax(), small_factors():
        found = jax.jit(jax.vmap(solution))(jnp.asarray(matrices, jnp.float32), jnp.asarray(b, jnp.float32))
    for a, right, x in zip(matrices, b, np.asarray(found), strict=True):
        expected = scipy.linalg.cho_solve(scipy.linalg.cho_factor(a), right)
        np.testing.assert_allclose(x, expected, rtol=2e-4, atol=1e-5 * np.abs(expected).max())


def test_a_small_factor_is_no_call_of_a_library(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    matrix = 2.0 * jnp.eye(6, dtype=jnp.float32)

    def primitives():
        with plain_jax():
            traced = jax.make_jaxpr(lambda a: jax.scipy.linalg.cho_factor(a)[0])(matrix)
        return str(traced)

    with small_factors():
        assert "cholesky" not in primitives()
    assert "cholesky" in primitives()


def test_a_matrix_that_is_not_positive_definite_gives_no_number(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")

    def solution(a, b):
        return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(a), b)

    with plain_jax(), small_factors():
        x = jax.jit(solution)(np.array([[1, 2], [2, 1]], np.float32), np.ones(2, np.float32))
    assert not np.isfinite(x).all()


def test_jax_is_left_as_it_was(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    usual = jax.scipy.linalg.cho_factor, jax.scipy.linalg.cho_solve
    with pytest.raises(RuntimeError), small_factors():
        raise RuntimeError
    assert (jax.scipy.linalg.cho_factor, jax.scipy.linalg.cho_solve) == usual
