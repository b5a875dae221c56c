"""Programs of scalars against the functions that they are made of."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.robots.kernel import scalars
from bojax.robots.kernel.scalars import NotScalar, ScalarProgram
from tests.compiling import IS_CPU

X = np.random.default_rng(0).normal(size=(4, 3))
INDEX = np.array([[2, 0], [1, 1]])
KEY = jax.random.key(3)


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


def drawn(x):
    key = jax.random.wrap_key_data((1e6 * jnp.abs(x[0, :2])).astype(jnp.uint32))
    keys = [jax.random.fold_in(key, (9.0 * jnp.abs(number)).astype(jnp.int32)) for number in x[1:].ravel()]
    draws = [jax.random.uniform(keys[i], (), dtype) for i, dtype in enumerate((jnp.float64, jnp.float32))]
    return *draws, jax.random.bits(keys[2], (3,), jnp.uint32), jax.random.key_data(keys[3])


def drawn_from_split_keys(x):
    key = jax.random.wrap_key_data((1e6 * jnp.abs(x[0, :2])).astype(jnp.uint32))
    first, second, *rest = jax.random.split(key, 6)
    return (
        jax.random.randint(first, (), 0, 7, jnp.int32),
        jax.random.choice(second, 3, p=jnp.asarray([0.2, 0.3, 0.5])),
        jax.random.normal(rest[0], (2,), jnp.float32),
        jax.random.exponential(rest[1], (), x.dtype),
        jax.vmap(jax.random.bits)(jax.random.split(rest[2])),
        jax.random.uniform(jax.vmap(jax.random.fold_in)(jax.random.split(rest[3]), np.int32([3, 4]))[1]),
    )


def drawn_from_known_keys(x):
    keys = jax.vmap(lambda i: jax.random.fold_in(KEY, i))(jnp.arange(3))
    return x[0] + jax.vmap(jax.random.uniform)(keys)


def words_of_a_chosen_key(x):
    keys = (jax.random.wrap_key_data(np.uint32([0, number])) for number in (1, 2))
    return jax.random.key_data(jnp.where(x[0, 0] > 0.0, *keys))


def printed(x):
    jax.debug.print("")
    return x


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
    "picks": lambda x: (
        x[jnp.argmax(x[:, 0]), 1],
        jax.lax.dynamic_slice(x, (jnp.argmax(x[:, 0]), jnp.argmax(x[0]) - 5), (2, 2)),
        jnp.argmax(x, 0),
        jnp.argmax(x > 0.0, 1),
    ),
    "running sums": lambda x: (jnp.cumsum(x, 1), jax.lax.cumsum(x, 0, reverse=True), jnp.cumsum(x[:0], 0)),
    "random numbers": drawn,
    "split keys": drawn_from_split_keys,
    "known keys": drawn_from_known_keys,
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


WIDE = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1.5, -300.0, 70000.0], np.float32)
WHOLE = np.array([7, -7, 7, -7, 5, 0, -(2**31), 2**31 - 1], np.int32)
DIVISORS = np.array([3, 3, -3, -3, 0, 0, 0, 2], np.int32)
ROW = np.arange(1, 7, dtype=np.float32)


def gathers(x, **mode):
    """Elements of vectors of four types, one of them outside."""
    types = x, x.astype(jnp.int8), x.astype(jnp.uint32), x > 0.0
    return [vector.at[jnp.array([1, 9])].get(**mode) for vector in types]


def quotients(x, y):
    return jax.lax.div(x, y), jax.lax.rem(x, y)


def extremes(x, y):
    return jax.lax.max(x, y), jax.lax.min(x, y)


SHIFTS = jax.lax.shift_left, jax.lax.shift_right_logical


AWKWARD = {
    "gathers with a value for what is outside": (lambda x: gathers(x, mode="fill", fill_value=1), ROW),
    "gathers that fill": (lambda x: gathers(x, mode="fill"), ROW),
    "gathers that clip": (lambda x: gathers(x, mode="clip"), ROW),
    "gathers that promise": (lambda x: gathers(x, mode="promise_in_bounds"), ROW),
    "windows": (
        lambda x: jax.lax.gather(
            x,
            jnp.array([[2], [5]]),
            jax.lax.GatherDimensionNumbers((1,), (), (0,)),
            (3,),
            mode="fill",
            fill_value=5.0,
        ),
        ROW,
    ),
    "no step": (
        lambda x, y: jax.lax.scan(lambda c, row: (0.5 * c + row, row), x, y),
        ROW[:2].copy(),
        np.ones((0, 2), np.float32),
    ),
    "no step over nothing": (lambda x: jax.lax.scan(lambda c, _: (2.0 * c, None), x, None, length=0)[0], ROW),
    "numbers one by one": (
        lambda x, y: jax.lax.scan(lambda c, number: (c * 2.0 + number, None), x, y)[0],
        ROW[0],
        ROW,
    ),
    "an empty carry": (
        lambda x, y: jax.lax.scan(lambda c, number: ((c[0], c[1] + number), None), (x[:0], x[0]), y)[0],
        ROW,
        ROW,
    ),
    "signs": (jnp.sign, WIDE),
    "the first that is no number": (lambda x: (jnp.argmax(x), jnp.argmax(x[::-1]), jnp.argmax(x[1:])), WIDE),
    "roots": (jax.lax.rsqrt, WIDE),
    "shifts by all bits": (
        lambda x: [f(x.astype(np.uint32), np.uint32(n)) for n in (3, 32, 99) for f in SHIFTS],
        ROW,
    ),
    "places that do not fit": (
        lambda x, y: [jax.lax.dynamic_slice(x, (y[-2].astype(d),), (2,)) for d in (np.int8, np.uint32)],
        ROW,
        WHOLE,
    ),
    "draws from a known key": (
        lambda x: x + jax.random.uniform(jax.random.fold_in(KEY, x[0].astype(int)), (), x.dtype),
        ROW,
    ),
    "total orders": (
        lambda x, y: [jnp.searchsorted(x, y[i], side="right", method="scan_unrolled") for i in range(8)],
        np.sort(np.concatenate([WIDE[1:], [np.float32(-0.0)]])),
        WIDE,
    ),
    "truth": (lambda x: [f(x > 1.0, x < 4.0) for f in (jax.lax.max, jax.lax.min)], ROW),
    "bits": (
        lambda x, y: (jax.lax.bitcast_convert_type(x, np.uint32), y ^ 5),
        WIDE,
        WHOLE,
    ),
    "integers divided": (quotients, WHOLE, DIVISORS),
    "numbers divided": (quotients, WIDE, WIDE[::-1].copy()),
    "zeros with signs": (extremes, np.float32([0.0, -0.0, -0.0]), np.float32([-0.0, 0.0, -0.0])),
    "one zero or the other": (lambda x: jnp.where(x > 0.0, jnp.float32(0.0), jnp.float32(-0.0)), WIDE),
    "other types": (lambda x: [x.astype(d) for d in (np.int8, np.uint8, np.int32, np.uint32, bool)], WIDE),
    "cases out of range": (
        lambda which, x: jax.lax.select_n(which, x, 2.0 * x, 3.0 * x),
        np.array([0, 1, 2, 3, -1, 2], np.int32),
        ROW,
    ),
    "nothing reduced": (
        lambda x, y: (
            [getattr(y.astype(d), name)(1, initial=0) for d in (int, bool) for name in ("max", "min")]
            + [jax.lax.reduce(y.astype(np.int32), np.int32(-(2**31)), jax.lax.max, (1,)), x]
        ),
        ROW,
        np.ones((2, 0), np.float32),
    ),
    "products of integers, and of a number with one": (
        lambda x, y: (
            jax.lax.dot(y, y, preferred_element_type=np.int32),
            jax.lax.dot(x, y, preferred_element_type=np.float32),
        ),
        ROW,
        np.full(6, 100, np.int8),
    ),
    "another order": (lambda x: jax.lax.reshape(x.reshape(2, 3), (6,), dimensions=(1, 0)), ROW),
}
"""Functions, and arguments for which operations of JAX and of NumPy, or their modes, differ."""


def test_awkward_numbers_are_those_of_jax():
    """As arguments of a program, and known to it; XLA's compiler fails to divide known integers by 0."""
    for name, (function, *arguments) in AWKWARD.items():
        if name == "other types" and not IS_CPU:  # a GPU converts numbers that do not fit as it likes
            continue
        values = [jnp.asarray(e) for x in arguments for e in np.reshape(x, -1)]
        known = ScalarProgram(lambda _, f=function, x=arguments: f(*map(jnp.asarray, x)), ROW[0])
        wanted = jax.tree.leaves(jax.jit(function)(*arguments))
        for found in (ScalarProgram(function, *arguments)(values), known([jnp.asarray(ROW[0])])):
            assert len(found) == sum(x.size for x in wanted), name
            for expected in wanted:
                numbers, found = np.array(found[: expected.size]), found[expected.size :]
                assert numbers.dtype == expected.dtype or not expected.size, name
                np.testing.assert_array_equal(numbers, np.ravel(expected), err_msg=name)
                if np.issubdtype(expected.dtype, np.floating):
                    signs = np.where(np.isnan(expected), 0.0, np.copysign(1.0, expected))
                    found_signs = np.where(np.isnan(numbers), 0.0, np.copysign(1.0, numbers))
                    np.testing.assert_array_equal(found_signs, np.ravel(signs), err_msg=name)


def test_the_least_integer_divided_by_minus_one():
    """As XLA computes it for arguments; of known numbers, XLA's compiler makes a division that traps."""
    least, minus = np.int32([-(2**31)]), np.int32([-1])
    program = ScalarProgram(lambda x: (jax.lax.div(least, minus), jax.lax.rem(least, minus), x), ROW[:1])
    assert [int(x) for x in program([jnp.asarray(1.0)])[:2]] == [-(2**31), 0]


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


@pytest.mark.parametrize("name", ["arithmetic", "products", "sums", "systems", "scans", "loops"])
def test_a_program_that_fuses_computes_the_same(name, monkeypatch):
    monkeypatch.setattr(scalars, "fused_product", lambda x, y, z: x * y + z)  # an operation of kernels alone
    program = ScalarProgram(FUNCTIONS[name], X, fuses=True)
    found = jax.jit(lambda x: program([*x.reshape(-1)]))(X)
    expected = np.concatenate([np.ravel(x) for x in jax.tree.leaves(FUNCTIONS[name](X))])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_sums_and_differences_take_the_products_in(monkeypatch):
    def function(x):
        shared = x[0, 0] * x[0, 1]
        return x @ x[0], shared + x[1, 0], x[1, 1] - x[1, 2] * x[0, 2], x[2, 0] * 3.0 - x[2, 1], shared

    fused = []
    monkeypatch.setattr(scalars, "fused_product", lambda *xs: fused.append(xs) or xs[0] * xs[1] + xs[2])
    program = ScalarProgram(function, X, fuses=True)
    traced = jax.make_jaxpr(lambda x: program([*x.reshape(-1)]))(X)
    names = [eqn.primitive.name for eqn in traced.eqns]
    # Of the three products of a row, the first one has nothing to be added to; another is a result, too.
    assert len(fused) == 4 * 2 + 3
    assert names.count("mul") == 4 + 1 + len(fused)
    assert names.count("sub") == 0


@pytest.mark.parametrize(
    "function",
    [
        lambda x: x.at[jnp.argmax(x[:, 0])].set(0.0),
        lambda x: x[0].astype(jnp.uint32) << x[1].astype(jnp.uint32),
        lambda x: jax.random.uniform(jax.random.key(0, impl="rbg"), (), x.dtype) * x,
        words_of_a_chosen_key,
        printed,
        lambda x: jax.lax.reduce(x, 1.0, lambda a, b: a * b + a, (1,)),
        lambda x: x.astype(jnp.bfloat16) + 1,
        lambda x: jnp.sort(x[0]),
        lambda x: jax.lax.erf_inv(x),
        lambda x: x.at[jnp.array([0, 1])].apply(jnp.sin),
        lambda x: jax.vmap(lambda y: jax.lax.while_loop(lambda c: c < 5.0, lambda c: c + 1.0, y))(x[0]),
        lambda x: jnp.linalg.cholesky(jnp.stack([x[:3], x[1:]])),
        lambda x: jax.lax.dot(x, x.T, preferred_element_type=jnp.float32),
        lambda x: jax.lax.cond(x[0, 0] > 0.0, jnp.sin, jnp.cos, x),
        lambda x: jax.lax.scan(lambda s, row: (s, row * s), 1.0, x)[1],
    ],
    ids=[
        "index",
        "shift",
        "rbg",
        "a chosen key",
        "output",
        "a reduction by a function",
        "bfloat16",
        "sort",
        "the inverse of an error function",
        "function",
        "conditions",
        "matrices",
        "precision",
        "branches",
        "rows",
    ],
)
def test_what_cannot_be_taken_apart_is_refused(function):
    with pytest.raises(NotScalar):
        ScalarProgram(function, X)


def test_keys_are_no_arguments():
    with pytest.raises(NotScalar, match="key"):
        ScalarProgram(jax.random.uniform, KEY)


def test_programs_for_triton_keep_nan(monkeypatch):
    program = ScalarProgram(lambda x, y: (*extremes(x, y), jnp.max(x)), WIDE, WIDE[::-1], keeps_nan=True)
    wanted = [*extremes(WIDE, WIDE[::-1].copy()), [np.nan]]
    monkeypatch.setattr(jax.lax, "max", jnp.fmax)  # as Triton's
    monkeypatch.setattr(jax.lax, "min", jnp.fmin)
    found = program([jnp.asarray(e) for e in (*WIDE, *WIDE[::-1])])
    np.testing.assert_array_equal(np.array(found), np.concatenate(wanted))


def test_a_shift_by_less_than_0_is_0():
    program = ScalarProgram(lambda x: [f(x, np.int32(-1)) for f in SHIFTS], WHOLE)
    assert program.outputs == [0] * 2 * len(WHOLE)


def test_a_function_without_arguments_is_refused():
    with pytest.raises(NotScalar, match="no arguments"):
        ScalarProgram(lambda x: x.sum(), np.zeros(0))


def test_a_large_program_is_refused():
    with pytest.raises(NotScalar, match="too many scalars"):
        ScalarProgram(lambda x: x @ x.T, X, most=50)
    with pytest.raises(NotScalar, match="too many scalars"):
        ScalarProgram(lambda x: x.shape[0], np.zeros(51), most=50)
