"""The Gaussian process, batch and incremental, against closed forms, scikit-learn and its own laws."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process import kernels as sk

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Matern12, Matern32, Matern52, Scaled
from bojax.models.means import ConstantMean
from bojax.numerics.linalg import noise_floor
from tests.refusals import assert_refused
from tests.tiers import by_tier

KERNELS = {
    "rbf": (RBF, sk.RBF(0.5)),
    "matern12": (Matern12, sk.Matern(0.5, nu=0.5)),
    "matern32": (Matern32, sk.Matern(0.5, nu=1.5)),
    "matern52": (Matern52, sk.Matern(0.5, nu=2.5)),
}
each_kernel = pytest.mark.parametrize("name", by_tier(KERNELS, normal=["rbf", "matern12"]))
"""The smoothest and the roughest in the normal tier; `EVERY_KERNEL` is compared with scikit-learn there."""

COMPOSITES = {
    "scaled": (Scaled(RBF(jnp.asarray([0.4, 0.9])), jnp.asarray(2.0)), 2.0 * sk.RBF([0.4, 0.9])),
    "sum": (
        Scaled(Matern52(jnp.asarray(0.5)), jnp.asarray(0.3)) + Matern12(jnp.asarray(2.0)),
        0.3 * sk.Matern(0.5, nu=2.5) + sk.Matern(2.0, nu=0.5),
    ),
    "product": (
        RBF(jnp.asarray(1.5)) * Matern32(jnp.asarray([0.5, 3.0])),
        sk.RBF(1.5) * sk.Matern([0.5, 3.0], nu=1.5),
    ),
}
EVERY_KERNEL = {name: (kernel(jnp.asarray(0.5)), theirs) for name, (kernel, theirs) in KERNELS.items()}
EVERY_KERNEL |= COMPOSITES
QUERIES = jnp.asarray(np.random.default_rng(99).uniform(-1.5, 1.5, (40, 2)))


def observations(num: int, seed: int = 0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (num, 2))
    return x, np.sin(3.0 * x[:, 0]) + x[:, 1] ** 2 + 0.1 * rng.normal(size=num)


def prior(noise_variance: float, capacity: int = 16, kernel=RBF, lengthscale=0.5) -> GaussianProcess:
    lengthscale, noise_variance = jnp.asarray(lengthscale), jnp.asarray(noise_variance)
    return GaussianProcess.prior(kernel(lengthscale), noise_variance, capacity, num_dims=2)


@jax.jit
def condition(gp: GaussianProcess, x, y) -> GaussianProcess:
    """The posterior after the observations, one after the other."""
    return jax.lax.scan(lambda gp, xy: (gp.update(*xy), None), gp, (x, y))[0]


@jax.jit
def predict(gp: GaussianProcess, xs):
    """Posterior mean and variance at `xs`."""
    return gp.predict(xs)


@jax.jit
def variances_along(gp: GaussianProcess, x, queries):
    """Variance at `queries` after each of the observations at `x`."""

    def step(gp, x):
        gp = gp.update(x, jnp.sum(x))
        return gp, gp.predict(queries)[1]

    return jax.lax.scan(step, gp, x)[1]


@each_kernel
@pytest.mark.parametrize("noise_variance", [0.0, 0.01])
@pytest.mark.parametrize("lengthscale", [0.5, 30.0])  # the second makes almost singular matrices
def test_the_variance_is_never_negative_and_never_grows(name, noise_variance, lengthscale):
    x, _ = observations(30)
    queries = np.concatenate([QUERIES, x])  # at the observations themselves too
    gp = prior(noise_variance, 30, KERNELS[name][0], lengthscale)
    variances = np.concatenate([np.ones((1, len(queries))), variances_along(gp, x, queries)])
    assert np.all(variances >= 0.0)
    assert np.all(np.diff(variances, axis=0) <= 1e-15)
    assert np.all(variances[-1] < 1.0)


def test_an_observation_beyond_the_capacity_leaves_no_trace():
    full = condition(prior(0.01), *observations(16))
    over = condition(full, *observations(16, seed=1))
    assert full.count == over.count == 16 and over.num_ignored == 16
    assert eqx.tree_equal(full, eqx.tree_at(lambda gp: gp.num_ignored, over, full.num_ignored))


@pytest.mark.parametrize("name", ["rbf", "matern12"])  # the smoothest and the roughest
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("size", [1, 5])
def test_points_observed_again_and_again_are_no_news(name, dtype, size):
    # A singular covariance matrix but for the noise: the worst that the factor can meet.
    atol = 1e-2 if dtype == jnp.float32 else 1e-4
    for noise_variance in (0.0, 1e-6):
        for apart in (0.0, 1e-9):
            x, _ = observations(5)
            x = np.tile(x, (6, 1)) + apart * np.random.default_rng(2).normal(size=(30, 2))
            y = np.sin(3.0 * x[:, 0]) + x[:, 1]
            x, y, queries = (np.asarray(a, dtype) for a in (x, y, QUERIES))
            kernel = KERNELS[name][0](jnp.asarray(0.5, dtype))
            gp = GaussianProcess.prior(kernel, jnp.asarray(noise_variance, dtype), 30, num_dims=2)
            gp = extend_by_blocks(gp, x.reshape(-1, size, 2), y.reshape(-1, size))
            mean, variance = predict(gp, np.concatenate([x, queries]))
            np.testing.assert_allclose(mean[:30], y, atol=atol)
            assert np.all(variance[:30] <= 10.0 * (noise_variance + noise_floor(dtype)))
            once = GaussianProcessRegressor(KERNELS[name][1], alpha=noise_floor(dtype), optimizer=None)
            np.testing.assert_allclose(mean[30:], once.fit(x[:5], y[:5]).predict(QUERIES), atol=2e-2)


@each_kernel
def test_gradients_of_a_prediction_are_finite_at_an_observation(name):
    x, y = observations(4)
    gp = condition(prior(0.01, capacity=4, kernel=KERNELS[name][0]), x, y)
    gradient = jax.jit(jax.jacobian(lambda query: jnp.stack(gp.predict(query[None]))))
    assert np.all(np.isfinite(gradient(x[2])))


fit = eqx.filter_jit(GaussianProcess.fit)
extend = eqx.filter_jit(GaussianProcess.extend)
update = eqx.filter_jit(GaussianProcess.update)
slopes = eqx.filter_jit(GaussianProcess.predict_gradient)
covariances = eqx.filter_jit(GaussianProcess.predict_covariance)
draw = eqx.filter_jit(GaussianProcess.sample)
evidence_of = jax.jit(GaussianProcess.log_marginal_likelihood)
weights_of = jax.jit(GaussianProcess.weights)


@jax.jit
def extend_by_blocks(gp: GaussianProcess, x, y) -> GaussianProcess:
    """The posterior after blocks of observations, [block, row]; after each of them if a block is one row."""

    def add(gp, block):
        x, y = block
        return gp.update(x[0], y[0]) if len(y) == 1 else gp.extend(x, y, jnp.ones(len(y), bool)), None

    return jax.lax.scan(add, gp, (x, y))[0]


def assert_same_posterior(one: GaussianProcess, other: GaussianProcess, atol: float):
    """Every number of two posteriors is the same up to rounding."""
    for left, right in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(left, right, rtol=0, atol=atol)


@pytest.mark.parametrize("name", EVERY_KERNEL)
def test_the_batch_posterior_and_its_evidence_are_those_of_scikit_learn(name):
    kernel, reference = EVERY_KERNEL[name]
    x, y = observations(16)
    gp = fit(kernel, jnp.asarray(0.05), x, y, capacity=20)
    batch = GaussianProcessRegressor(reference, alpha=0.05, optimizer=None).fit(x, y)
    expected_mean, expected_covariance = batch.predict(QUERIES, return_cov=True)
    mean, covariance = covariances(gp, QUERIES)
    np.testing.assert_allclose(mean, expected_mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(covariance, expected_covariance, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.diagonal(covariance), predict(gp, QUERIES)[1], atol=1e-14)
    np.testing.assert_allclose(weights_of(gp)[:16], batch.alpha_, atol=1e-11)
    evidence = batch.log_marginal_likelihood(batch.kernel_.theta)
    np.testing.assert_allclose(evidence_of(gp), evidence, rtol=0, atol=1e-9)


@pytest.mark.parametrize("num", [0, 1, 5, 9])
def test_rows_past_the_count_do_not_exist(num):
    # The posterior depends on the first rows only, whatever the values of the others.
    kernel, noise = COMPOSITES["sum"][0], jnp.asarray(0.1)
    x, y = observations(9)
    is_held = np.arange(9) < num
    spoilt = np.where(is_held[:, None], x, np.nan), np.where(is_held, y, np.nan)
    gp = fit(kernel, noise, *spoilt, count=jnp.asarray(num, jnp.int32), capacity=12)
    one_by_one = GaussianProcess.prior(kernel, noise, 12, num_dims=2)
    for i in range(num):
        one_by_one = update(one_by_one, x[i], y[i])
    assert_same_posterior(gp, one_by_one, 1e-12)
    evidence = evidence_of(one_by_one)
    np.testing.assert_allclose(evidence_of(gp), evidence, atol=1e-12)


@pytest.mark.parametrize("name, capacity", [("rbf", 30), ("matern12", 30), ("product", 30), ("sum", 11)])
def test_a_block_of_observations_is_one_after_the_other(name, capacity):
    # Five blocks of six points, some of them invalid; the smaller capacity is exceeded inside a block.
    kernel = EVERY_KERNEL[name][0]
    x, y = observations(30)
    is_valid = np.random.default_rng(3).random(30) < 0.6
    is_valid[6:12], is_valid[18:24] = False, True
    assert is_valid.sum() > 12
    one_by_one = blocks = GaussianProcess.prior(kernel, jnp.asarray(0.01), capacity, num_dims=2)
    for i in range(30):
        if is_valid[i]:
            one_by_one = update(one_by_one, x[i], y[i])
        if i % 6 == 5:
            block = slice(i - 5, i + 1)
            seen = is_valid[block]
            missing = np.where(seen[:, None], x[block], np.nan), np.where(seen, y[block], np.inf)
            blocks = extend(blocks, *missing, seen)
    assert int(blocks.count) == min(capacity, is_valid.sum())
    assert_same_posterior(blocks, one_by_one, 1e-9)
    np.testing.assert_allclose(predict(blocks, QUERIES), predict(one_by_one, QUERIES), rtol=0, atol=1e-12)
    # Absent rows are zero, as promised.
    assert not np.any(blocks.inverse_cholesky[:, int(blocks.count) :])


@pytest.mark.parametrize("name", ["rbf", "matern12"])
def test_what_the_first_observations_say_is_the_posterior_given_them_alone(name):
    kernel, mean, (x, y) = EVERY_KERNEL[name][0], ConstantMean(jnp.asarray(0.4)), observations(12)
    whole = fit(kernel, jnp.asarray(0.01), x, y, mean=mean, capacity=15)
    counts = np.asarray([0, 1, 7, 12])
    means, variances = jax.jit(GaussianProcess.predict_first)(whole, QUERIES, counts)
    for count, found in zip(counts.tolist(), zip(means, variances, strict=True), strict=True):
        part = fit(kernel, jnp.asarray(0.01), x[:count], y[:count], mean=mean, capacity=15)
        np.testing.assert_allclose(found, predict(part, QUERIES), atol=1e-11)


def test_every_observation_may_have_its_own_noise():
    x, y = observations(12)
    noise = 10.0 ** np.random.default_rng(5).uniform(-3.0, 0.0, 12)
    kernel, reference = COMPOSITES["scaled"]
    batch = GaussianProcessRegressor(reference, alpha=noise, optimizer=None).fit(x, y)
    expected_mean, expected_std = batch.predict(QUERIES, return_std=True)
    empty = GaussianProcess.prior(kernel, jnp.asarray(7.0), 12, num_dims=2)
    one_by_one = empty
    for i in range(12):
        one_by_one = update(one_by_one, x[i], y[i], noise[i])
    order = np.random.default_rng(6).permutation(12)
    blocks = extend(empty, x[order], y[order], np.ones(12, bool), noise[order])
    at_once = fit(kernel, jnp.asarray(7.0), x, y, noise_variances=noise)
    for gp in (one_by_one, blocks, at_once):
        mean, variance = predict(gp, QUERIES)
        np.testing.assert_allclose(mean, expected_mean, atol=1e-12)
        np.testing.assert_allclose(variance, expected_std**2, atol=1e-12)
        evidence = batch.log_marginal_likelihood(batch.kernel_.theta)
        np.testing.assert_allclose(evidence_of(gp), evidence, atol=1e-10)


@pytest.mark.parametrize("name", EVERY_KERNEL)
def test_the_gradient_of_the_mean_is_its_slope(name):
    gp = fit(EVERY_KERNEL[name][0], jnp.asarray(0.05), *observations(16), capacity=20)
    step, gradient, queries = 1e-6 * np.eye(2), slopes(gp, QUERIES), np.asarray(QUERIES)
    for axis in range(2):
        above, below = (predict(gp, queries + sign * step[axis])[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(gradient[:, axis], (above - below) / 2e-6, atol=1e-7)


def test_the_evidence_has_the_gradient_of_scikit_learn():
    x, y = map(jnp.asarray, observations(16))
    lengthscale, variance, noise = jnp.asarray([0.4, 0.9]), jnp.asarray(2.0), jnp.asarray(0.1)

    def evidence(log_variance, log_lengthscale, log_noise):
        kernel = Scaled(RBF(jnp.exp(log_lengthscale)), jnp.exp(log_variance))
        gp = GaussianProcess.fit(kernel, jnp.exp(log_noise), x, y, capacity=20)
        return gp.log_marginal_likelihood()

    logs = jnp.log(variance), jnp.log(lengthscale), jnp.log(noise)
    ours = jax.jit(jax.grad(evidence, argnums=(0, 1, 2)))(*logs)
    reference = sk.ConstantKernel(2.0) * sk.RBF([0.4, 0.9]) + sk.WhiteKernel(0.1)
    batch = GaussianProcessRegressor(reference, alpha=0.0, optimizer=None).fit(x, y)
    theirs = batch.log_marginal_likelihood(batch.kernel_.theta, eval_gradient=True)[1]
    np.testing.assert_allclose(np.hstack(ours), theirs, rtol=1e-10)


def test_samples_have_the_mean_and_covariance_of_the_posterior():
    gp = fit(COMPOSITES["scaled"][0], jnp.asarray(0.1), *observations(4), capacity=6)
    queries, number = QUERIES[:5], 40_000
    mean, covariance = (np.asarray(found) for found in covariances(gp, queries))
    samples = np.asarray(draw(gp, jax.random.key(0), queries, number))
    assert samples.shape == (number, 5)
    # Six standard errors.
    variance = np.diagonal(covariance)
    np.testing.assert_array_less(np.abs(samples.mean(axis=0) - mean), 6.0 * np.sqrt(variance / number))
    spread = np.sqrt((variance[:, None] * variance[None, :] + covariance**2) / number)
    np.testing.assert_array_less(np.abs(np.cov(samples.T) - covariance), 6.0 * spread)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_samples_of_one_function_agree_where_points_coincide(dtype):
    # The covariance of 30 copies of 10 points, some of them observed without noise, is singular.
    x, y = (a.astype(dtype) for a in observations(5))
    gp = fit(RBF(jnp.asarray(2.0, dtype)), jnp.asarray(0.0, dtype), x, y)
    points = np.concatenate([x, np.asarray(QUERIES[:5], dtype)])
    samples = np.asarray(draw(gp, jax.random.key(1), np.tile(points, (3, 1)), 50)).reshape(50, 3, 10)
    exact = np.sqrt(1e3 * noise_floor(dtype))
    np.testing.assert_allclose(samples[:, 1:], np.stack([samples[:, 0]] * 2, axis=1), atol=exact)
    np.testing.assert_allclose(samples[:, 0, :5], np.tile(y[None], (50, 1)), atol=exact)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_observations_that_are_not_finite_are_left_out_and_counted(bad):
    x, y = observations(6)
    expected = condition(prior(0.01), x[[0, 1, 3]], y[[0, 1, 3]])
    x[2, 1], y[4] = bad, bad
    one_by_one = condition(prior(0.01), x[:5], y[:5])
    block = extend(condition(prior(0.01), x[:2], y[:2]), x[2:5], y[2:5], np.ones(3, bool))
    at_once = fit(RBF(jnp.asarray(0.5)), jnp.asarray(0.01), x[:5], y[:5])
    for found in (one_by_one, block, at_once):
        assert found.count == 3 and found.num_ignored == 2
        for ours, theirs in zip(predict(found, QUERIES), predict(expected, QUERIES), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-10)
    relearned = jax.jit(lambda gp: gp.refitted(gp.kernel, gp.noise_variance))(one_by_one)
    assert relearned.num_ignored == 2
    assert extend(expected, x[2:5], y[2:5], np.zeros(3, bool)).num_ignored == 0


def test_outside_of_jit_what_would_be_left_out_is_refused():
    gp = prior(0.01, capacity=4).extend(*observations(3))
    x, y = observations(2, seed=1)
    holed = np.where(np.arange(2) == 1, np.nan, y)
    assert_refused(
        [
            (lambda: gp.extend(x, holed), "ys: 1 of 2 numbers are not finite"),
            (lambda: gp.extend(holed[:, None] * x, y), "xs: 2 of 4 numbers are not finite"),
            (lambda: gp.update(x[0], -np.inf), "y: 1 of 1 numbers are not finite"),
            (lambda: GaussianProcess.fit("rbf", 0.01, x, holed), "y: 1 of 2 numbers are not finite"),
            (lambda: gp.extend(x, y), "ys: got 2 more beside 3; allowed: 4 observations, the capacity"),
            (lambda: gp.update(x[0], y[0]).update(x[1], y[1]), "y: got 1 more beside 4; allowed: 4 obs"),
        ]
    )
    masked = gp.extend(x, holed, [True, False])
    assert masked.count == 4 and np.all(np.isfinite(masked.y)) and masked.num_ignored == 0


@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_outside_of_jit_a_variance_that_cannot_be_is_refused(value):
    x, y = observations(2)
    gp, fit, wrong = prior(0.01), GaussianProcess.fit, f"noise_variance: got {value}; allowed: finite .*>= 0"
    kernel = f"kernel: prior variance: got {value}; allowed: finite"
    one_short = r"noise_variances: got shape \(1,\); allowed: \(2,\)"
    assert_refused(
        [
            (lambda: fit("rbf", value, x, y), wrong),
            (lambda: fit("rbf", 0.1, x, y, noise_variances=[0.1, value]), wrong),
            (lambda: gp.update(x[0], y[0], value), wrong),
            (lambda: gp.extend(x, y, noise_variances=[value, 0.1]), wrong),
            (lambda: fit("rbf", 0.1, x, y, noise_variances=[0.1]), one_short),
            (lambda: fit(Scaled(RBF(1.0), value), 0.1, x, y), kernel),
        ]
    )


def test_a_noise_variance_below_the_floor_is_raised_with_a_warning():
    x, y = observations(20)
    floor = noise_floor(jnp.float64)
    with pytest.warns(UserWarning, match="noise_variance: got 1e-10; raised to 1.8.*e-09"):
        quiet = GaussianProcess.fit("rbf", 1e-10, x, y)
    at_floor = GaussianProcess.fit("rbf", 1.001 * floor, x, y)
    np.testing.assert_allclose(quiet.log_marginal_likelihood(), at_floor.log_marginal_likelihood(), rtol=1e-2)
    for call in (
        lambda gp: gp.update(x[0], y[0], 1e-11),
        lambda gp: gp.extend(x[:2], y[:2], noise_variances=[1.0, 1e-12]),
    ):
        with pytest.warns(UserWarning, match="raised to"):
            call(prior(0.01))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prior(0.01).update(x[0], y[0], 0.0).extend(x[:2], y[:2], [True, True], [1.0, 0.5])


def test_a_batch_of_processes_is_a_loop():
    noise, lengthscale = np.asarray([0.01, 0.1, 1.0]), np.asarray([0.2, 0.5, 1.0])
    data = [observations(8, seed) for seed in range(3)]
    x, y = (np.stack(column) for column in zip(*data, strict=True))
    is_valid = np.random.default_rng(8).random((3, 8)) < 0.5

    def posterior(lengthscale, noise_variance, x, y, is_valid):
        gp = GaussianProcess.fit(RBF(lengthscale), noise_variance, x[:4], y[:4], capacity=11)
        gp = condition(gp.extend(x, y, is_valid), x[:2], y[:2])
        return (*gp.predict(QUERIES), gp.log_marginal_likelihood(), gp.predict_gradient(QUERIES))

    lanes, one = (lengthscale, noise, x, y, is_valid), jax.jit(posterior)
    batched = jax.jit(jax.vmap(posterior))(*lanes)
    for lane in range(3):
        alone = one(*(each[lane] for each in lanes))
        for expected, found in zip(alone, batched, strict=True):
            np.testing.assert_allclose(found[lane], expected, atol=1e-11)


def paths(num: int, seed: int) -> np.ndarray:
    """Eight points a metre along winding paths through 6 x 6 m."""
    rng = np.random.default_rng(seed)
    point, points = np.array([3.0, 3.0]), []
    for _ in range(num // 8):
        heading = rng.uniform(0.0, 2.0 * np.pi)
        for turn in rng.uniform(-0.2, 0.2, 8):
            point = np.clip(point + 0.125 * np.array([np.cos(heading), np.sin(heading)]), 0.0, 6.0)
            heading += turn
            points.append(point)
    return np.array(points)


@pytest.mark.parametrize("variance, noise_variance", [(1.0, 0.0), (1e12, 0.01), (1e-12, 0.0)])
@pytest.mark.parametrize("dtype, tolerance", [(jnp.float32, 5e-3), (jnp.float64, 1e-5)])
@pytest.mark.parametrize("size", [1, 8])
def test_without_noise_a_factor_that_grows_row_by_row_stays_one(
    variance, noise_variance, dtype, tolerance, size
):
    # Samples of a smooth field along paths: nearly dependent rows, whose rounding errors accumulate.
    points = paths(200, seed=1).astype(dtype)
    scale = variance**0.5
    values = np.asarray(scale, dtype) * np.sin(points[:, 0]) * np.cos(points[:, 1])
    kernel = Scaled(RBF(jnp.asarray(1.0, dtype)), jnp.asarray(variance, dtype))
    gp = GaussianProcess.prior(kernel, jnp.asarray(noise_variance, dtype), 200, num_dims=2)
    gp = extend_by_blocks(gp, points.reshape(-1, size, 2), values.reshape(-1, size))
    queries = np.random.default_rng(3).uniform(1.0, 5.0, (50, 2)).astype(dtype)
    mean, spread = predict(gp, queries)
    floor = noise_floor(dtype) * variance
    exact = GaussianProcessRegressor(variance * sk.RBF(1.0), alpha=floor, optimizer=None)
    exact.fit(np.asarray(points, np.float64), np.asarray(values, np.float64))
    expected_mean, expected_std = exact.predict(np.asarray(queries, np.float64), return_std=True)
    assert np.abs(np.asarray(gp.inverse_cholesky)).max() < 1.01 / np.sqrt(floor)
    np.testing.assert_allclose(mean / scale, expected_mean / scale, atol=tolerance)
    np.testing.assert_allclose(np.sqrt(spread) / scale, expected_std / scale, atol=tolerance)


def test_lists_and_python_numbers_are_as_good_as_arrays():
    numbers = jnp.asarray

    def everything(kernel, noise, x, y, noises, later, value, queries):
        gp = GaussianProcess.fit(kernel, noise, x, y, capacity=5, noise_variances=noises)
        gp = gp.update(later, value, noise).extend(queries, y)
        return gp, gp.predict(queries), gp.predict_gradient(queries)

    kernel = {"kind": "scaled", "kernel": {"kind": "matern52", "lengthscale": 2}, "variance": 3}
    given = kernel, 0.5, [0, 1], [1, 2.5], (0.1, 0.2), 3, np.float32(1.0), [0.5, 2]
    lists = jax.jit(lambda: everything(*given))()
    arrays = (
        *(Scaled(Matern52(numbers(2.0)), numbers(3.0)), numbers(0.5)),
        *(numbers([[0.0], [1.0]]), numbers([1.0, 2.5]), numbers([0.1, 0.2])),
        *(numbers([3.0]), numbers(1.0), numbers([[0.5], [2.0]])),
    )
    assert eqx.tree_equal(lists, jax.jit(everything)(*arrays), rtol=1e-12, atol=1e-12)


def test_inputs_take_the_precision_of_the_kernel():
    def predicted():
        gp = GaussianProcess.fit(RBF(np.float32(0.5)), 0.1, np.zeros((2, 1)), [1, 2])
        return gp, gp.update(0.5, np.float64(1)).predict(np.ones(3)), gp.sample(jax.random.key(0), [1], 2)

    found = jax.tree.leaves(jax.eval_shape(predicted))
    assert {leaf.dtype for leaf in found} == {jnp.dtype("float32"), jnp.dtype("int32")}


def test_inputs_of_the_wrong_kind_are_refused_in_one_line():
    gp, fit = prior(0.1), GaussianProcess.fit
    too_many = "capacity: got 3; allowed: >= 4, the number of observations"
    assert_refused(
        [
            (lambda: gp.predict([[1, 2, 3]]), r"xs: got shape \(1, 3\); allowed: \[points, 2\]"),
            (lambda: gp.predict([1, 2]), r"xs: got shape \(2,\); allowed: \[points, 2\]"),
            (lambda: gp.predict("here"), 'xs: got "here"; allowed: numbers'),
            (lambda: gp.update([1], 0), r"x: got shape \(1,\); allowed: \[2\]"),
            (lambda: fit("rbf", 0.1, [1, 2], [1]), r"y: got shape \(1,\); allowed: 2 numbers"),
            (lambda: fit("rbf", 0.1, [[1], [2, 3]], [1, 2]), "x: got .*; allowed: numbers"),
            (lambda: fit("rfb", 0.1, [1], [1]), 'unknown kernel; .*; did you mean "rbf"'),
            (lambda: fit("my:Own", 0.1, [1], [1]), "my:Own; allowed: a name, or an object"),
            (lambda: fit("rbf", 0.1, *observations(4), capacity=3), too_many),
            (lambda: GaussianProcess.prior("rbf", 0.1, -1, 1), "capacity: got -1; allowed: an integer >= 0"),
            (lambda: fit("rbf", [0.1, 0.2], [1, 2], [1, 2]), "noise_variance: got shape .*; allowed: one"),
            (lambda: gp.sample(jax.random.key(0), [[1, 2]], -1), "num: got -1; allowed: an integer >= 0"),
        ]
    )
