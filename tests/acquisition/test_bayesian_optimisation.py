"""Algorithm 1 against plain NumPy, and on functions whose maximum is known; and its standardised values."""

import functools
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float, Int
from scipy import stats

from bojax.acquisition.bayesian_optimisation import NOISE_SPREAD_BELOW, BayesianOptimisation, standardise
from bojax.acquisition.functions import LogExpectedImprovement, UpperConfidenceBound
from bojax.models.kernels import RBF, Matern52
from bojax.numerics.quasirandom import shifted_kronecker
from tests.acquisition.cases import ACQUISITIONS, each_acquisition
from tests.reference import bayesian_optimisation as reference
from tests.reference.bridge import reference_acquisition, reference_kernel
from tests.refusals import assert_refused, without_annotation_checks
from tests.tiers import by_tier

each_search = pytest.mark.parametrize("name", by_tier(ACQUISITIONS, normal=["ucb"]))
"""Long searches by one acquisition function; those by the others are slow."""

NUM_ITERATIONS = 12

# These programs run for milliseconds; compilation dominates the time.
_jit = eqx.filter_jit


def optimisation(acquisition=ACQUISITIONS["ucb"], low=(-1.0, -1.0), high=(1.0, 1.0), **changes):
    settings = {"kernel": RBF(jnp.asarray(0.5)), "noise_variance": jnp.asarray(1e-4)}
    sizes = {"capacity": NUM_ITERATIONS, "num_candidates": 64, "num_initial": 3, "refine_steps": 8}
    return BayesianOptimisation(
        acquisition=acquisition,
        low=jnp.asarray(low),
        high=jnp.asarray(high),
        **{**settings, **sizes, **changes},
    )


def _peak(x):
    return 1.0 / (1.0 + jnp.sum((x - jnp.asarray([0.3, -0.6], x.dtype)) ** 2))


def _negative_branin(x):
    """Branin's function, whose three minima of 0.397887 lie in [-5, 10] x [0, 15], upside down."""
    a = x[1] - 5.1 / (4.0 * np.pi**2) * x[0] ** 2 + 5.0 / np.pi * x[0] - 6.0
    return -(a**2 + 10.0 * (1.0 - 1.0 / (8.0 * np.pi)) * jnp.cos(x[0]) + 10.0)


LANDSCAPES = (
    lambda key, x: _peak(x),
    lambda key, x: jnp.where(x[1] > 0.3, jnp.nan, _peak(x)),
    lambda key, x: jnp.asarray(2.5, x.dtype),
    lambda key, x: jnp.asarray(jnp.nan, x.dtype),
    lambda key, x: x[0] - 2.0 * x[1],
    lambda key, x: jax.random.normal(key, dtype=x.dtype),
    lambda key, x: _negative_branin(x),
)


class Landscape(eqx.Module):
    """One of `LANDSCAPES`, by its number: a program that is compiled for one serves for all."""

    number: Int[Array, ""]

    def __call__(self, key, x):
        return jnp.stack([landscape(key, x) for landscape in LANDSCAPES])[self.number]


peak, gap, plain, nowhere, slope, noise, negative_branin = (
    Landscape(jnp.asarray(number, jnp.int32)) for number in range(len(LANDSCAPES))
)
"""One peak of height 1 at (0.3, -0.6); the same behind a third of the box without values; 2.5; no values; a
plane; noise alone; and Branin's function."""


@_jit
def maximise(optimisation, key, function=peak, num_iterations=NUM_ITERATIONS):
    return optimisation.maximise(key, function, num_iterations)


@_jit
def maximise_lanes(optimisations, keys, function=peak, num_iterations=NUM_ITERATIONS):
    """Every leaf of the optimisation is a batch axis."""
    return jax.vmap(lambda one, key: one.maximise(key, function, num_iterations))(optimisations, keys)


def seeds(number: int):
    return jax.vmap(jax.random.key)(jnp.arange(number))


def stacked(optimisations):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *optimisations)


def step_by_step(optimisation, key, function, num_iterations=NUM_ITERATIONS):
    """`maximise`, by asking and telling."""
    key_search, key_noise = jax.random.split(key)
    init, ask, tell = (
        _jit(f) for f in (type(optimisation).init, type(optimisation).ask, type(optimisation).tell)
    )
    state, xs, ys = init(optimisation, key_search), [], []
    evaluate = _jit(function)
    for i in range(num_iterations):
        xs.append(ask(optimisation, state))
        ys.append(evaluate(jax.random.fold_in(key_noise, i), xs[-1]))
        state = tell(optimisation, state, xs[-1], ys[-1])
    return state, jnp.stack(xs), jnp.stack(ys)


def assert_equal_leaves(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        np.testing.assert_array_equal(a, b)


@each_acquisition
@pytest.mark.parametrize("function", [peak, gap], ids=["peak", "gap"])
def test_points_and_values_are_those_of_plain_numpy(acquisition, function):
    one = optimisation(acquisition)
    state, xs, ys = maximise(one, jax.random.key(7), function)
    key_search, _ = jax.random.split(jax.random.key(7))

    def draw(*path):
        key = functools.reduce(jax.random.fold_in, path, key_search)
        return np.asarray(shifted_kronecker(key, 64, 2, jnp.float64))

    evaluate = _jit(function)
    expected_xs, expected_ys = reference.maximise(
        lambda x: float(evaluate(jax.random.key(0), jnp.asarray(x))),
        reference_kernel(one.kernel),
        reference_acquisition(acquisition),
        noise_variance=1e-4,
        num_initial=3,
        refine_steps=8,
        initial=draw(0),
        candidates=[draw(1, i) for i in range(NUM_ITERATIONS)],
    )
    np.testing.assert_allclose(xs, expected_xs, atol=1e-8)
    np.testing.assert_allclose(ys, expected_ys, atol=1e-8)
    assert int(state.num_missing) == np.isnan(expected_ys).sum()


@pytest.mark.parametrize("relearn_every", by_tier([0, 5], normal=[0]))
def test_asking_and_telling_is_the_loop(relearn_every):
    one = optimisation(low=(-2.0, 0.0), high=(1.0, 3.0), relearn_every=relearn_every)
    assert_equal_leaves(step_by_step(one, jax.random.key(3), gap), maximise(one, jax.random.key(3), gap))


def test_a_batch_of_problems_is_a_loop_and_its_lanes_differ():
    problems = [
        optimisation(
            UpperConfidenceBound(jnp.asarray(kappa)),
            kernel=Matern52(jnp.asarray(lengthscale)),
            noise_variance=jnp.asarray(noise),
            high=(high, 1.0),
        )
        for kappa, lengthscale, noise, high in [
            (1.0, 0.3, 1e-2, 1.0),
            (2.0, 0.5, 1e-3, 2.0),
            (2.0, 0.5, 1e-3, 2.0),
        ]
    ]
    _, lane_xs, lane_ys = maximise_lanes(stacked(problems), seeds(3))
    for lane, problem in enumerate(problems):
        _, xs, ys = maximise(problem, jax.random.key(lane))
        np.testing.assert_allclose(lane_xs[lane], xs, atol=1e-8)
        np.testing.assert_allclose(lane_ys[lane], ys, atol=1e-8)
    assert len(np.unique(np.asarray(lane_xs)[:, -1], axis=0)) == 3


LANES, LONG = 16, 40
"""Number of lanes and of iterations of long searches, which share one program an acquisition."""


def searched(function, one):
    """Final states, points and values of equal optimisations of capacity `LONG`."""
    return maximise_lanes(stacked([one] * LANES), seeds(LANES), function, LONG)


@each_search
def test_the_minimum_of_branin_is_found_by_maximising_its_negative(name):
    low, high = (-5.0, 0.0), (10.0, 15.0)
    state, _, ys = searched(
        negative_branin, one := optimisation(ACQUISITIONS[name], low, high, capacity=LONG)
    )
    np.testing.assert_allclose(best_of(one, state)[1], np.max(ys, axis=1), rtol=1e-12)
    regret = -0.397887 - np.max(ys, axis=1)
    assert np.all(regret > -1e-6) and np.all(regret < 0.5) and np.median(regret) < 0.05
    points = jnp.asarray(np.random.default_rng(0).uniform(low, high, (LANES * LONG, 2)))
    at_random = jax.jit(jax.vmap(partial(negative_branin, jax.random.key(0))))(points)
    assert np.median(regret) < 0.1 * np.median(-0.397887 - at_random.reshape(LANES, LONG).max(axis=1))


best_of = _jit(lambda one, state: jax.vmap(one.best)(state))


# The probability of improvement is left out: it prefers a sure gain, however small, to the corner.
@pytest.mark.parametrize("name", by_tier(["ucb", "log-ei"], normal=["ucb"]))
def test_a_maximum_in_a_corner_is_found_there(name):
    one = optimisation(ACQUISITIONS[name], low=(-0.1, 3.0), high=(0.7, 3.1), capacity=LONG)
    state, xs, ys = searched(slope, one)
    assert np.all(np.asarray(xs) >= np.asarray(one.low)) and np.all(np.asarray(xs) <= np.asarray(one.high))
    best, value = best_of(one, state)
    np.testing.assert_allclose(best, np.broadcast_to([0.7, 3.0], (LANES, 2)), atol=1e-3)
    np.testing.assert_allclose(value, 0.7 - 6.0, atol=3e-3)


@each_acquisition
def test_a_constant_function_is_explored(acquisition):
    # All means are equal, so the variance decides, which favours new points.
    _, xs, ys = maximise(optimisation(acquisition), jax.random.key(0), plain)
    assert np.all(np.isfinite(xs)) and np.all(ys == 2.5)
    distance = np.linalg.norm(np.asarray(xs)[:, None] - np.asarray(xs)[None], axis=-1)
    assert np.min(distance + 10.0 * np.eye(len(xs))) > 0.1


class Bowl(eqx.Module):
    """A quadratic function in units of one's own."""

    scale: Float[Array, ""]
    offset: Float[Array, ""]

    def __call__(self, key, x):
        del key
        return self.scale * jnp.sum((x - jnp.asarray([0.3, -0.6], x.dtype)) ** 2) + self.offset


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_the_units_of_the_objective_do_not_matter(dtype):
    one = jax.tree.map(lambda leaf: leaf.astype(dtype), optimisation())
    for sign in (1.0, -1.0):
        found = []
        for scale, offset in ((1.0, 0.0), (1e-12, 0.0), (1e12, 0.0), (1.0, 100.0)):
            bowl = Bowl(jnp.asarray(sign * scale, dtype), jnp.asarray(offset, dtype))
            _, xs, ys = maximise(one, jax.random.key(0), bowl)
            assert xs.dtype == ys.dtype == dtype
            found.append(xs)
        # The rest is rounding.
        for xs in found[1:]:
            np.testing.assert_allclose(xs, found[0], atol=1e-3 if dtype == jnp.float32 else 1e-8)


def test_an_evaluation_beyond_the_capacity_is_refused_or_counted():
    one = optimisation(capacity=2)
    state = one.tell(one.tell(one.init(jax.random.key(0)), [0.0, 0.0], 1.0), [0.5, 0.5], np.nan)
    state = one.tell(state, [0.5, 0.0], 2.0)
    with pytest.raises(ValueError, match="tell: got one observation more than 2; allowed: <= capacity"):
        one.tell(state, [1.0, 1.0], 3.0)
    after = _jit(type(one).tell)(one, state, jnp.ones(2), jnp.asarray(3.0))
    assert after.model.num_ignored == 1 and after.num_missing == 1 and after.num_told == 4
    assert one.best(after)[1] == 2.0
    assert one.tell(state, [1.0, 1.0], np.inf).num_missing == 2  # takes no room


def test_hyperparameters_are_relearned_when_due_and_kept_between():
    one = optimisation(relearn_every=5, num_initial=9)
    key_search, _ = jax.random.split(jax.random.key(0))
    tell, state = _jit(type(one).tell), one.init(key_search)
    for number in range(1, 12):
        x = jnp.asarray([0.1 * number - 0.5, (-0.7) ** number])
        before, state = state, tell(one, state, x, jnp.cos(4.0 * x[0]) + 5.0)
        is_relearned = state.model.kernel.lengthscale != before.model.kernel.lengthscale
        assert is_relearned == (number % 5 == 0)
        np.testing.assert_allclose(state.model.y[number - 1], jnp.cos(4.0 * x[0]) + 5.0, rtol=1e-14)


@pytest.mark.parametrize("spread", by_tier([1.5, 0.5], normal=[1.5]))
def test_what_is_relearned_has_the_greatest_posterior_density(spread):
    settings = {"kernel": RBF(jnp.asarray([0.1, 0.1])), "prior_spread": spread}
    one = optimisation(relearn_every=NUM_ITERATIONS, **settings)
    state, xs, ys = maximise(one, jax.random.key(0))
    assert np.all(state.model.kernel.lengthscale > 0.15)
    values = (np.asarray(ys) - np.mean(ys)) / np.std(ys)

    def log_density(logs):
        """Up to a constant, the evidence by SciPy plus the log-normal prior around the given values."""
        lengthscale, noise = np.exp(logs[:2]), np.exp(logs[2])
        distance = (np.asarray(xs)[:, None] - np.asarray(xs)[None]) / lengthscale
        covariance = np.exp(-0.5 * np.sum(distance**2, axis=-1)) + noise * np.eye(len(values))
        weights = np.linalg.solve(covariance, np.ones(len(values)))
        mean = np.full(len(values), weights @ values / weights.sum())  # the best constant
        evidence = stats.multivariate_normal(mean, covariance).logpdf(values)
        away = (logs - np.log([0.1, 0.1, 1e-4])) / spread
        away[2] /= NOISE_SPREAD_BELOW if away[2] < 0.0 else 1.0
        return evidence - 0.5 * np.sum(away**2)

    found = np.log([*state.model.kernel.lengthscale, state.model.noise_variance])
    assert state.model.mean.value != 0.0
    for away in np.random.default_rng(0).normal(size=(30, 3)):
        assert log_density(found) > log_density(found + 0.3 * away) - 1e-6
        assert log_density(found) > log_density(found + 3.0 * away)


def test_missing_values_are_counted_and_teach_nothing():
    one = optimisation()
    tell = _jit(type(one).tell)
    state, xs, ys = maximise(one, jax.random.key(0))
    more = tell(one, state, xs[0], jnp.asarray(1.0))
    assert more.num_told == NUM_ITERATIONS + 1 and more.num_missing == 0
    for value in (jnp.nan, jnp.inf, -jnp.inf):
        missing = tell(one, state, xs[0], jnp.asarray(value))
        assert missing.num_missing == 1 and missing.num_told == NUM_ITERATIONS + 1 and missing.was_missing
        assert_equal_leaves(missing.model, state.model)
        assert_equal_leaves(one.best(missing), one.best(state))
    nowhere = tell(one, state, jnp.asarray([jnp.nan, 0.0]), jnp.asarray(1.0))
    assert nowhere.num_missing == 1
    assert_equal_leaves(nowhere.model, state.model)


def test_a_function_without_values_is_still_searched():
    state, xs, ys = maximise(optimisation(), jax.random.key(0), nowhere)
    assert state.num_missing == NUM_ITERATIONS and state.model.count == 0
    assert np.all(np.isnan(ys)) and len(np.unique(xs, axis=0)) == NUM_ITERATIONS


def test_before_any_observation_the_best_is_the_centre_of_the_box():
    one = optimisation(low=(-2.0, 0.0), high=(1.0, 3.0))
    x, y = one.best(one.init(jax.random.key(0)))
    np.testing.assert_array_equal(x, [-0.5, 1.5])
    assert y == -np.inf


def test_noise_differs_between_iterations_and_lanes():
    _, _, ys = searched(noise, optimisation(capacity=LONG))
    assert len(np.unique(ys)) == LANES * LONG


def test_python_numbers_and_lists_are_as_good_as_arrays():
    arrays = optimisation(LogExpectedImprovement(jnp.asarray(0.0)), low=(-5.0, 0.0), high=(10.0, 15.0))
    numbers = BayesianOptimisation(
        kernel="rbf",
        acquisition={"kind": "log-ei", "xi": 0},
        noise_variance=1e-4,
        low=[-5, 0],
        high=(10, 15),
        capacity=NUM_ITERATIONS,
        num_candidates=64,
        num_initial=3,
        refine_steps=8,
    )
    assert_equal_leaves(arrays, numbers)
    state = _jit(numbers.init)(jax.random.key(0))
    told = jax.jit(lambda state: numbers.tell(state, [1, 2.5], 3))(state)
    from_arrays = _jit(type(arrays).tell)(arrays, state, jnp.asarray([1.0, 2.5]), jnp.asarray(3.0))
    assert_equal_leaves(told, from_arrays)
    queries = [[0, 1], [2.5, 3]]
    listed = jax.jit(lambda state: (numbers.predict(state, queries), numbers.score(state, queries)))(told)
    expected, scores = _jit(lambda state, xs: (arrays.predict(state, xs), arrays.score(state, xs)))(
        told, jnp.asarray(queries)
    )
    assert_equal_leaves(listed, (expected, scores))
    with pytest.raises(ValueError, match=r"xs: got shape \(2,\); allowed: \[points, 2\]"):
        numbers.predict(told, [0, 1])
    x, value = numbers.best(told)
    np.testing.assert_allclose(x, [1.0, 2.5], rtol=1e-14)
    assert value == 3.0


class OneForEachAxis(RBF):
    """A kernel whose author forgot the sum over the axes."""

    def __call__(self, x, y):
        return jnp.exp(-0.5 * ((x - y) / self.lengthscale) ** 2)


class Branching(RBF):
    """A kernel with a branch of Python."""

    def __call__(self, x, y):
        return super().__call__(x, y) if x[0] > 0.0 else super().__call__(y, x)


def test_numbers_that_make_no_sense_are_refused():
    box = {"low": [-1.0, -1.0], "high": [1.0, 1.0], "noise_variance": 0.1, "kernel": RBF(0.5)}
    sizes = {"capacity": 1, "num_candidates": 1, "num_initial": 1, "refine_steps": 0, "relearn_every": 0}
    noise = "allowed: a number >= 0, representable in float64"
    single = "kernel.lengthscale: got float32; allowed: float64, as `low`"
    settings = [
        ({"kernel": RBF([0.5] * 3)}, r"kernel: does not accept points of dimension 2 \(those of the box\)"),
        ({"kernel": OneForEachAxis(0.5)}, r"kernel: returns \(2,\) for a point; allowed: one number"),
        ({"kernel": Branching(0.5)}, r"dimension 2 \(those of the box\): Branching: .*allowed: jnp.where"),
        ({"kernel": RBF(0.0)}, "kernel.lengthscale: got 0; allowed: > 0"),
        ({"kernel": RBF(np.float32(0.5))}, single),
        ({"acquisition": UpperConfidenceBound(np.nan)}, "acquisition.kappa: got a number that is not finite"),
        ({"noise_variance": -1}, f"noise_variance: got -1.0; {noise}"),
        ({"noise_variance": "0.1"}, 'noise_variance: got "0.1"; allowed: numbers'),
        ({"noise_variance": None}, "noise_variance: got None; allowed: numbers"),
        # The median of a log-normal prior.
        ({"prior_spread": 0.0}, "prior_spread: got 0.0; allowed: a number > 0"),
        ({"noise_variance": 0, "relearn_every": 5}, "noise_variance: got 0.0; allowed: a number > 0"),
        ({"low": [0.0, 1.0]}, r"high\[1\]: got 1; allowed: > low\[1\], which is 1, and finite"),
        ({"low": [-1.7e308, 0.0], "high": [1.7e308, 1.0]}, r"high\[0\]: got 1.7e\+308; allowed: > low"),
        ({"low": [0, "a"]}, r"low: got \[0, 'a'\]; allowed: numbers"),
        ({"low": [[0.0], [1.0, 2.0]]}, "low: got .*; allowed: numbers"),
        *(({n: m - 1}, f"{n}: got {m - 1}; allowed: an integer >= {m}") for n, m in sizes.items()),
    ]
    given = {"acquisition": ACQUISITIONS["ucb"], **box, "capacity": NUM_ITERATIONS}
    assert_refused((lambda s=s: BayesianOptimisation(**{**given, **s}), message) for s, message in settings)
    too_many = "num_iterations: got 13; allowed: <= 12, the capacity"
    assert_refused([(lambda: optimisation().maximise(jax.random.key(0), peak, 13), too_many)])


def test_values_of_wrong_types_end_in_one_line_each():
    right = {"kernel": RBF(0.5), "acquisition": UpperConfidenceBound(2), "noise_variance": 0.1}
    right |= {"low": [0, 0], "high": [1, 1], "capacity": 5}
    wrong = [
        ("kernel", "rfb", '"rfb"'),
        ("kernel", RBF, "<class 'bojax....kernels.RBF'>"),
        ("acquisition", "eii", '"eii"'),
        ("acquisition", None, "None"),
        ("noise_variance", [0.1], r"shape \(1,\)"),
        ("low", 0, r"shape \(\)"),
        ("high", [1, 1, 1], r"shape \(3,\)"),
        ("capacity", 5.0, "5.0"),
        ("capacity", "5", '"5"'),
        ("num_candidates", None, "None"),
    ]
    with without_annotation_checks():
        assert_refused(
            (
                lambda name=name, value=value: BayesianOptimisation(**{**right, name: value}),
                f"^{name}: got {text};",
            )
            for name, value, text in wrong
        )
        search = BayesianOptimisation(**right)
        state, key = search.init(jax.random.key(0)), jax.random.key(0)
        assert_refused(
            [
                (lambda: search.init(0), "^key: got 0;"),
                (lambda: search.tell(state, [1], 1), r"^x, y: got shapes \(1,\) and \(\);"),
                (lambda: search.tell(state, [1, 2], None), "^y: got None;"),
                (lambda: search.maximise(0, lambda key, x: x[0], 2), "^key: got 0;"),
                (lambda: search.maximise(key, lambda key, x: x[0], 2.0), "^num_iterations: got 2.0;"),
            ]
        )


def test_predictions_are_those_of_a_gaussian_process_in_the_units_of_the_objective():
    low, high = np.array([0.0, -2.0]), np.array([4.0, 2.0])
    one = optimisation(
        low=low, high=high, kernel=Matern52(jnp.asarray(0.6)), noise_variance=jnp.asarray(0.05)
    )
    random = np.random.default_rng(0)
    xs, ys = random.uniform(low, high, (4, 2)), 100.0 + 7.0 * random.standard_normal(4)
    state = _jit(one.init)(jax.random.key(0))
    tell, predict = _jit(type(one).tell), _jit(type(one).predict)
    for x, y in zip(xs, ys, strict=True):
        state = tell(one, state, x, y)
    at = random.uniform(low, high, (5, 2))
    mean, std = predict(one, state, jnp.asarray(at))

    def unit(x):
        return 2.0 * (x - low) / (high - low) - 1.0

    def covariance(a, b):
        s = 5.0**0.5 * np.linalg.norm(unit(a)[:, None] - unit(b)[None], axis=2) / 0.6
        return (1.0 + s + s**2 / 3.0) * np.exp(-s)

    weights = np.linalg.solve(covariance(xs, xs) + 0.05 * np.eye(4), covariance(xs, at))
    expected = ys.mean() + weights.T @ (ys - ys.mean())
    variance = ys.var() * (1.0 - np.sum(covariance(xs, at) * weights, axis=0))
    np.testing.assert_allclose(mean, expected, rtol=1e-9)
    np.testing.assert_allclose(std, np.sqrt(variance), rtol=1e-9)
    np.testing.assert_allclose(one.noise_std(state), ys.std() * 0.05**0.5, rtol=1e-12)


@pytest.mark.parametrize("num", [0, 1, 3])
def test_equal_values_have_the_unit_1_as_no_value_has(num):
    one = optimisation(
        low=[0.0], high=[1.0], kernel=Matern52(jnp.asarray(0.2)), noise_variance=jnp.asarray(0.05)
    )
    state = _jit(one.init)(jax.random.key(0))
    for _ in range(num):
        state = _jit(type(one).tell)(one, state, jnp.asarray([0.1]), jnp.asarray(-300.0))
    mean, std = _jit(type(one).predict)(one, state, jnp.asarray([[0.1], [0.9]]))
    np.testing.assert_allclose(mean, -300.0 if num else 0.0, rtol=1e-12)
    near = (0.05 / (0.05 + num)) ** 0.5  # of a process of variance 1 after `num` observations of the point
    np.testing.assert_allclose(std, [near, 1.0], rtol=1e-3)
    np.testing.assert_allclose(one.noise_std(state), 0.05**0.5, rtol=1e-12)


scaled = jax.jit(lambda *args: standardise(*args)[0])
RNG = np.random.default_rng(0)
EXISTS = jnp.arange(12) < 9


@pytest.mark.parametrize("scale", [1e-200, 1e-3, 1.0, 1e200])
@pytest.mark.parametrize("offset", [0.0, 1.0, -1e6])
def test_mean_and_variance_are_those_of_the_standard_normal(scale, offset):
    values = scale * (RNG.normal(size=12) + offset)
    found = np.asarray(scaled(jnp.asarray(values), EXISTS))
    np.testing.assert_allclose(found[:9].mean(), 0.0, atol=1e-8)
    np.testing.assert_allclose(found[:9].std(), 1.0, rtol=1e-12)
    relative = values / scale
    np.testing.assert_allclose(
        found[:9], (relative[:9] - relative[:9].mean()) / relative[:9].std(), atol=1e-8
    )


@pytest.mark.parametrize("rest", [0.0, 5.0, np.nan, np.inf])
def test_what_does_not_exist_has_no_part(rest):
    values = jnp.asarray(RNG.normal(size=12))
    alone = scaled(values[:9], EXISTS[:9])
    found = scaled(jnp.where(EXISTS, values, rest), EXISTS)
    np.testing.assert_allclose(found[:9], alone, atol=1e-14)
    np.testing.assert_array_equal(found[9:], 0.0)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("value", [0.0, 0.1, -1e6, 1e30])
def test_equal_values_and_no_values_are_zero(dtype, value):
    for exists in (EXISTS, jnp.zeros(12, bool)):
        np.testing.assert_array_equal(scaled(jnp.full(12, value, dtype), exists), jnp.zeros(12, dtype))


def test_a_small_difference_between_large_values_counts():
    found = scaled(jnp.asarray([1e6, 1e6 + 1e-3]), jnp.ones(2, bool))
    np.testing.assert_allclose(found, [-1.0, 1.0], rtol=1e-6)
