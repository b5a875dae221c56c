"""Short loops: the unrolled form of accelerators and the loop of a CPU."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.linalg import guarded_cholesky, solve_small
from bojax.numerics.loops import MOST_UNROLLED, short_loop


@pytest.fixture
def on_backend(monkeypatch):
    """Makes `short_loop` choose its form for a backend."""
    return lambda name: monkeypatch.setattr(jax, "default_backend", lambda: name)


def num_loops(number: int) -> int:
    program = jax.make_jaxpr(lambda x: short_loop(number, lambda k, x: x + k, x))(jnp.zeros(()))
    return sum(equation.primitive.name in ("while", "scan") for equation in program.eqns)


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_the_steps_are_applied_in_order(on_backend, backend):
    on_backend(backend)
    result = short_loop(4, lambda k, x: 10.0 * x + k, jnp.ones(()))
    assert float(result) == 10123.0


def test_a_gpu_unrolls_a_few_steps(on_backend):
    on_backend("gpu")
    assert num_loops(MOST_UNROLLED) == 0 and num_loops(MOST_UNROLLED + 1) == 1
    on_backend("cpu")
    assert num_loops(2) == 1


@pytest.mark.parametrize("num_columns", [5, 8, 11])  # less than a block of columns, one, and more than one
def test_eliminations_are_the_same_in_both_forms(on_backend, num_columns):
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(12, 12))
    matrix, right = jnp.asarray(factor @ factor.T + np.eye(12)), jnp.asarray(rng.normal(size=(12, 2)))
    results = []
    for backend in ("cpu", "gpu"):
        on_backend(backend)
        eliminate = jax.jit(lambda a, b: (guarded_cholesky(a, jnp.ones(12), num_columns), solve_small(a, b)))
        results.append(jax.tree.leaves(eliminate(matrix, right)))
    for loop, unrolled in zip(*results, strict=True):
        np.testing.assert_allclose(loop, unrolled, rtol=1e-12, atol=1e-14)
