"""The incremental Gaussian process against its closed form, scikit-learn, and the laws of conditioning."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process import kernels as sk

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Matern12, Matern32, Matern52
from bojax.numerics.linalg import noise_floor

KERNELS = {
    "rbf": (RBF, sk.RBF(0.5)),
    "matern12": (Matern12, sk.Matern(0.5, nu=0.5)),
    "matern32": (Matern32, sk.Matern(0.5, nu=1.5)),
    "matern52": (Matern52, sk.Matern(0.5, nu=2.5)),
}
QUERIES = jnp.asarray(np.random.default_rng(99).uniform(-1.5, 1.5, (40, 2)))


def observations(num: int, seed: int = 0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (num, 2))
    return jnp.asarray(x), jnp.asarray(np.sin(3.0 * x[:, 0]) + x[:, 1] ** 2 + 0.1 * rng.normal(size=num))


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


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("noise_variance", [1e-4, 0.01, 1.0])
def test_one_observation_at_a_time_gives_the_batch_posterior(name, noise_variance):
    kernel, reference = KERNELS[name]
    x, y = observations(16)
    mean, variance = predict(condition(prior(noise_variance, kernel=kernel), x, y), QUERIES)
    batch = GaussianProcessRegressor(reference, alpha=noise_variance, optimizer=None).fit(x, y)
    expected_mean, expected_std = batch.predict(QUERIES, return_std=True)
    np.testing.assert_allclose(mean, expected_mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(variance, expected_std**2, rtol=0, atol=1e-9)


@pytest.mark.parametrize("capacity", [7, 30])
def test_equals_the_closed_form_with_a_lengthscale_for_each_dimension(capacity):
    lengthscale, noise_variance = np.array([0.3, 1.2]), 0.05
    x, y = observations(7)
    gp = condition(prior(noise_variance, capacity, lengthscale=lengthscale), x, y)
    mean, variance = predict(gp, QUERIES)

    def k(a, b):
        scaled = (np.asarray(a)[:, None, :] - np.asarray(b)[None, :, :]) / lengthscale
        return np.exp(-0.5 * (scaled**2).sum(axis=-1))

    inverse = np.linalg.inv(k(x, x) + noise_variance * np.eye(7))
    expected_variance = 1.0 - np.einsum("mn,nk,mk->m", k(QUERIES, x), inverse, k(QUERIES, x))
    np.testing.assert_allclose(mean, k(QUERIES, x) @ inverse @ np.asarray(y), atol=1e-12)
    np.testing.assert_allclose(variance, expected_variance, atol=1e-12)
    cholesky = np.linalg.cholesky(k(x, x) + noise_variance * np.eye(7))
    np.testing.assert_allclose(gp.inverse_cholesky[:7, :7], np.linalg.inv(cholesky), atol=1e-11)


def test_the_order_of_observations_does_not_matter():
    x, y = observations(16)
    order = np.random.default_rng(1).permutation(16)
    forwards = predict(condition(prior(0.01), x, y), QUERIES)
    shuffled = predict(condition(prior(0.01), x[order], y[order]), QUERIES)
    for one, other in zip(forwards, shuffled, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("noise_variance", [0.0, 0.01])
@pytest.mark.parametrize("lengthscale", [0.5, 30.0])  # the second makes almost singular matrices
def test_the_variance_is_never_negative_and_never_grows(name, noise_variance, lengthscale):
    x, _ = observations(30)
    queries = jnp.concatenate([QUERIES, x])  # at the observations themselves too
    gp = prior(noise_variance, 30, KERNELS[name][0], lengthscale)
    variances = np.concatenate([np.ones((1, len(queries))), variances_along(gp, x, queries)])
    assert np.all(variances >= 0.0)
    assert np.all(np.diff(variances, axis=0) <= 1e-15)
    assert np.all(variances[-1] < 1.0)


def test_without_observations_the_posterior_is_the_prior():
    mean, variance = predict(prior(0.01), QUERIES)
    np.testing.assert_array_equal(mean, np.zeros(len(QUERIES)))
    np.testing.assert_array_equal(variance, np.ones(len(QUERIES)))


@pytest.mark.parametrize("noise_variance", [0.0, 0.25])
def test_one_observation_shrinks_towards_the_prior_by_its_noise(noise_variance):
    x, y = jnp.asarray([[0.2, -0.4]]), jnp.asarray([3.0])
    mean, variance = predict(condition(prior(noise_variance), x, y), x)
    np.testing.assert_allclose(mean, 3.0 / (1.0 + noise_variance), rtol=2.0 * noise_floor(x.dtype))
    np.testing.assert_allclose(variance, 1.0 - 1.0 / (1.0 + noise_variance), atol=2.0 * noise_floor(x.dtype))


def test_without_noise_the_mean_interpolates():
    x, y = observations(16)
    mean, variance = predict(condition(prior(0.0, kernel=Matern32), x, y), x)
    np.testing.assert_allclose(mean, y, atol=1e-9)
    np.testing.assert_allclose(variance, 0.0, atol=1e-9)


def test_an_observation_beyond_the_capacity_leaves_no_trace():
    full = condition(prior(0.01), *observations(16))
    over = condition(full, *observations(16, seed=1))
    assert full.count == over.count == 16
    assert eqx.tree_equal(full, over)


@pytest.mark.parametrize("name", ["rbf", "matern12"])  # the smoothest and the roughest
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("noise_variance", [0.0, 1e-6])
@pytest.mark.parametrize("apart", [0.0, 1e-9])
def test_points_observed_again_and_again_are_no_news(name, dtype, noise_variance, apart):
    # A singular covariance matrix but for the noise: the worst that the factor can meet.
    x, _ = observations(5)
    x = jnp.tile(x, (6, 1)) + apart * jnp.asarray(np.random.default_rng(2).normal(size=(30, 2)))
    y = jnp.sin(3.0 * x[:, 0]) + x[:, 1]
    x, y, queries = (a.astype(dtype) for a in (x, y, QUERIES))
    kernel = KERNELS[name][0](jnp.asarray(0.5, dtype))
    gp = condition(GaussianProcess.prior(kernel, jnp.asarray(noise_variance, dtype), 30, num_dims=2), x, y)
    mean, variance = predict(gp, jnp.concatenate([x, queries]))
    np.testing.assert_allclose(mean[:30], y, atol=1e-2 if dtype == jnp.float32 else 1e-4)
    assert np.all(variance[:30] <= 10.0 * (noise_variance + noise_floor(dtype)))
    once = GaussianProcessRegressor(KERNELS[name][1], alpha=noise_floor(dtype), optimizer=None).fit(
        x[:5], y[:5]
    )
    np.testing.assert_allclose(mean[30:], once.predict(QUERIES), atol=2e-2)


def test_contradicting_observations_without_noise_give_their_mean():
    x, y = jnp.asarray([[0.1, 0.2]] * 2), jnp.asarray([1.0, 2.0])
    mean, variance = predict(condition(prior(0.0), x, y), x)
    np.testing.assert_allclose(mean, 1.5, atol=1e-3)
    np.testing.assert_allclose(variance, 0.0, atol=1e-9)


def test_a_repeated_point_averages_out_its_noise():
    x, values = jnp.asarray([[0.1, 0.2]] * 6), jnp.asarray([1.0, 2.0, 0.5, 1.5, 2.5, 1.5])
    mean, variance = predict(condition(prior(0.3), x, values), x[:1])
    np.testing.assert_allclose(mean, values.sum() / (6 + 0.3), rtol=1e-13)
    np.testing.assert_allclose(variance, 0.3 / (6 + 0.3), rtol=1e-12)


def test_a_batch_of_processes_is_a_loop():
    noise = jnp.asarray([0.01, 0.1, 1.0])
    lengthscale = jnp.asarray([0.2, 0.5, 1.0])
    data = [observations(6, seed) for seed in range(3)]
    x, y = (jnp.stack(column) for column in zip(*data, strict=True))

    def posterior(lengthscale, noise_variance, x, y):
        gp = GaussianProcess.prior(RBF(lengthscale), noise_variance, 6, num_dims=2)
        return condition(gp, x, y).predict(QUERIES)

    batched = jax.jit(jax.vmap(posterior))(lengthscale, noise, x, y)
    one = jax.jit(posterior)
    for lane in range(3):
        alone = one(lengthscale[lane], noise[lane], x[lane], y[lane])
        for expected, found in zip(alone, batched, strict=True):
            np.testing.assert_allclose(found[lane], expected, atol=1e-13)


@pytest.mark.parametrize("name", KERNELS)
def test_gradients_of_a_prediction_are_finite_at_an_observation(name):
    x, y = observations(4)
    gp = condition(prior(0.01, capacity=4, kernel=KERNELS[name][0]), x, y)
    gradient = jax.jit(jax.jacobian(lambda query: jnp.stack(gp.predict(query[None]))))
    assert np.all(np.isfinite(gradient(x[2])))
