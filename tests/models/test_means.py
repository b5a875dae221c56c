"""Prior means alone, and as part of a Gaussian process."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.models.means import ConstantMean, LinearMean, ZeroMean

MEANS = {
    "zero": (ZeroMean(), lambda x: np.zeros(len(x))),
    "constant": (ConstantMean(jnp.asarray(4.0)), lambda x: np.full(len(x), 4.0)),
    "linear": (
        LinearMean(jnp.asarray([2.0, -1.0]), jnp.asarray(0.5)),
        lambda x: 2.0 * x[:, 0] - x[:, 1] + 0.5,
    ),
}
KERNEL, NOISE = Scaled(Matern52(jnp.asarray(0.5)), jnp.asarray(3.0)), jnp.asarray(0.1)
rng = np.random.default_rng(0)
X, Y = jnp.asarray(rng.uniform(-1.0, 1.0, (9, 2))), jnp.asarray(rng.normal(size=9))
QUERIES = jnp.asarray(rng.uniform(-2.0, 2.0, (20, 2)))
fit = eqx.filter_jit(GaussianProcess.fit)


@jax.jit
def described(gp):
    """Moments and gradient at the queries, evidence, weights and residuals."""
    evidence = gp.log_marginal_likelihood()
    return *gp.predict(QUERIES), gp.predict_gradient(QUERIES), evidence, gp.weights(), gp.residuals()


each_mean = pytest.mark.parametrize("name", MEANS)


@each_mean
def test_without_observations_it_is_the_prediction(name):
    mean, values = MEANS[name]
    gp = GaussianProcess.prior(KERNEL, NOISE, 4, 2, mean)
    predicted, variance, _, evidence, _, residuals = described(gp)
    np.testing.assert_allclose(predicted, values(np.asarray(QUERIES)), rtol=1e-15)
    np.testing.assert_array_equal(variance, 3.0)
    np.testing.assert_array_equal(residuals, 0.0)
    assert evidence == 0.0


@each_mean
def test_conditioning_adds_what_the_mean_leaves(name):
    # m(x) + the posterior of a process of mean zero on y - m(X).
    mean, values = MEANS[name]
    gp = fit(KERNEL, NOISE, X, Y, mean=mean, capacity=12)
    rest = fit(KERNEL, NOISE, X, Y - jnp.asarray(values(np.asarray(X))))
    predicted, variance, gradient, evidence, weights, residuals = described(gp)
    of_rest, expected_variance, slope, expected_evidence, expected_weights, _ = described(rest)
    np.testing.assert_allclose(predicted, values(np.asarray(QUERIES)) + of_rest, atol=1e-13)
    np.testing.assert_allclose(variance, expected_variance, atol=1e-13)
    np.testing.assert_allclose(evidence, expected_evidence, rtol=1e-13)
    np.testing.assert_allclose(weights[:9], expected_weights, atol=1e-12)
    np.testing.assert_array_equal(residuals[9:], 0.0)
    slope = slope + jax.jit(jax.vmap(jax.grad(lambda x: mean(x))))(QUERIES)
    np.testing.assert_allclose(gradient, slope, atol=1e-12)
