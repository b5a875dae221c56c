"""Programs of scalars against the functions that they are made of."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.scalars import NotScalar, ScalarProgram

X = np.random.default_rng(0).normal(size=(4, 3))
INDEX = np.array([[2, 0], [1, 1]])


def systems(x):
    a = x @ x.T + jnp.eye(4)
    factor = jax.scipy.linalg.cho_factor(a, lower=True)
    return jax.scipy.linalg.cho_solve(factor, x[:, 0]), jnp.linalg.cholesky(a)


def scanned(x):
    def step(carry, row):
        number, total = carry
        return (number + 1, total + row * number), None

    return jax.lax.scan(step, (jnp.float64(1.0), jnp.zeros(3)), x)[0]


def nested(x):
    """A loop around a loop, each with an invariant of its own."""

    def outer(carry):
        number, total = carry
        factor = x[1] * number.astype(x.dtype)
        inner = jax.lax.while_loop(lambda s: s[0] < 10.0, lambda s: s + jnp.abs(factor) + 1.0, total)
        return number + 1, inner - x[0] @ x[1]

    return jax.lax.while_loop(lambda carry: carry[0] < 4, outer, (0, x[2]))


FUNCTIONS = {
    "arithmetic": lambda x: jnp.where(x > 0.0, jnp.sin(x) / 3.0 - x**3, jnp.sqrt(jnp.abs(x)) * x),
    "bounds": lambda x: (jnp.clip(x, -0.5, jnp.inf), jnp.maximum(x, -jnp.inf), jnp.sign(x), jnp.isfinite(x)),
    "booleans": lambda x: (x > 0.0) & (np.arange(3) > 0)[None] | ~(x < 1.0),
    "products": lambda x: (x @ x.T, jnp.einsum("ij,ik->ijk", x, x[:, ::-1]), np.eye(4) @ x),
    "sums": lambda x: (x.sum(0), x.max(), x.min(1), (x > 0.0).any(0), (x > 0.0).all(), x[:0].sum()),
    "moves": lambda x: (x.T.reshape(2, 6), x[1:, ::2], x[::-1], jnp.tile(x[0], 2), jnp.stack([*x], 1)),
    "parts": lambda x: (
        jnp.split(x, 2)[1],
        jnp.concatenate([x, np.ones((1, 3))]),
        jnp.diag(x[0]),
        jnp.pad(x, 1),
    ),
    "gathers": lambda x: (
        x[INDEX],
        x[:, INDEX[0]],
        x[INDEX[0], INDEX[1]],
        jnp.take(x, jnp.array([9]), axis=0),
    ),
    "lanes of gathers": lambda x: jax.vmap(lambda row, i: row[i])(x, np.array([2, 0, 1, 1])),
    "scatters": lambda x: (
        x.at[1].set(x[0]),
        x.at[INDEX[0]].add(x[1]),
        x.at[:, 0].mul(2.0),
        jnp.zeros((3, 3)).at[INDEX[0], INDEX[1]].add(x[0, 0]),
        x.at[9].set(0.0),
    ),
    "types": lambda x: (x.astype(jnp.float32), (x > 0.0).astype(x.dtype) * x, (x > 0.0).sum(0)),
    "systems": systems,
    "scans": scanned,
    "loops": nested,
    "constants": lambda x: (jnp.cumsum(np.arange(3.0)), jnp.argsort(np.array([2, 1, 2, 0])), 1.0),
    "numbers": lambda x: (jnp.arange(12).reshape(4, 3)[:, ::2], jnp.argmax(INDEX, 1), jnp.eye(3) * x[0, 0]),
}
"""Functions of `X`; every rule is in one of them."""


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_program_computes_what_its_function_does(name):
    function = FUNCTIONS[name]
    program = ScalarProgram(function, X)
    found = iter(jax.jit(lambda x: program([*x.reshape(-1)]))(X))
    for expected in jax.tree.leaves(jax.jit(function)(X)):
        values = np.reshape([next(found) for _ in range(expected.size)], expected.shape)
        assert values.dtype == expected.dtype
        np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
    assert next(found, None) is None


def test_lanes_are_values_of_any_shape():
    program = ScalarProgram(FUNCTIONS["products"], X)
    lanes = np.random.default_rng(1).normal(size=(5, 12))
    together = program([*jnp.asarray(lanes.T)])
    alone = np.array([program([*jnp.asarray(lane)]) for lane in lanes])
    np.testing.assert_allclose(np.stack(together, 1), alone, rtol=1e-12, atol=1e-12)


def test_known_zeros_and_repetitions_cost_nothing():
    mask = np.diag([1.0, 0.0, 0.0])

    def function(x):
        return (mask @ x[:3]).sum() + (mask @ x[:3]).sum() * 0.0, x[0] * x[1], x[1] * x[0] * 1.0 + 0.0

    program = ScalarProgram(function, X)
    traced = jax.make_jaxpr(lambda x: program([*x.reshape(-1)]))(X)
    names = [eqn.primitive.name for eqn in traced.eqns]
    assert names.count("add") == 2
    assert names.count("mul") == 6


@pytest.mark.parametrize(
    "function",
    [
        lambda x: x[jnp.argmax(x[:, 0])],
        lambda x: jnp.sort(x[0]),
        lambda x: jax.lax.scan(lambda s, row: (s, row * s), 1.0, x)[1],
    ],
    ids=["index", "sort", "rows"],
)
def test_what_cannot_be_taken_apart_is_refused(function):
    with pytest.raises(NotScalar):
        ScalarProgram(function, X)


def test_a_large_program_is_refused():
    with pytest.raises(NotScalar, match="too many scalars"):
        ScalarProgram(lambda x: x @ x.T, X, most=50)
