"""Acquisition functions against SciPy and against expectations integrated numerically, far into the tails."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

from bojax.acquisition.functions import (
    Acquisition,
    ExpectedImprovement,
    LogExpectedImprovement,
    ProbabilityOfImprovement,
    UpperConfidenceBound,
)
from tests.acquisition.cases import ACQUISITIONS, each_acquisition

SCORES = [-1e8, -1e5, -300.0, -40.0, -20.5, -20.0, -19.5, -10.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 5.0, 30.0]
"""Standard scores (mean - best) / std, on both sides of every change of formula."""

score = jax.jit(lambda acquisition, mean, std, best: acquisition(mean, std, best))


@jax.jit
def gradients(acquisition: Acquisition, mean, std, best):
    """Derivatives with respect to the mean and the standard deviation, at every point."""

    def alone(mean, std):
        return acquisition(mean[None], std[None], best)[0]

    return jax.vmap(jax.grad(alone, argnums=(0, 1)))(mean, std)


def log_expected_improvement(z: float) -> float:
    """log E[max(Y, 0)] for Y ~ N(z, 1): log of phi(z) times the integral of t exp(z t - t^2/2) over t > 0."""
    if z < -1.0:  # the same integral in s = -z t, where its mass is near s = 1
        value, _ = integrate.quad(lambda s: s * np.exp(-s - 0.5 * (s / z) ** 2), 0, np.inf, epsrel=1e-13)
        return stats.norm.logpdf(z) + np.log(value) - 2.0 * np.log(-z)
    value, _ = integrate.quad(lambda t: t * stats.norm.pdf(t - z), 0, z + 40.0, points=[max(z, 0.1)])
    return np.log(value)


@pytest.mark.parametrize("std", [0.01, 1.0, 20.0])
@pytest.mark.parametrize("xi", [0.0, 0.3])
def test_log_expected_improvement_is_the_logarithm_of_the_expectation(std, xi):
    best = 0.7
    mean = best + xi + std * np.array(SCORES)
    found = score(
        LogExpectedImprovement(jnp.asarray(xi)), jnp.asarray(mean), jnp.full(16, std), jnp.asarray(best)
    )
    # `mean` is rounded, so the expected scores are computed from its rounded values.
    z = (mean - (best + xi)) / std
    expected = [log_expected_improvement(value) + np.log(std) for value in z]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("std", [0.01, 20.0])
@pytest.mark.parametrize("xi", [0.0, 0.3])
def test_expected_improvement_is_the_expectation(std, xi):
    best, z = 0.7, np.array([-20.5, -10.0, -1.5, -1.0, 0.0, 0.5, 5.0, 30.0])
    mean = best + xi + std * z
    acquisition = ExpectedImprovement(jnp.asarray(xi))
    found = score(acquisition, jnp.asarray(mean), jnp.full(8, std), jnp.asarray(best))
    z = (mean - (best + xi)) / std  # the mean is rounded
    expected = [std * np.exp(log_expected_improvement(value)) for value in z]
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_log_expected_improvement_in_single_precision_and_far_into_the_tail():
    z = np.concatenate([-np.logspace(15, 0, 500), np.linspace(-30.0, 10.0, 500)]).astype(np.float32)
    acquisition = LogExpectedImprovement(jnp.asarray(0.0, jnp.float32))
    found = score(acquisition, jnp.asarray(z), jnp.ones(1000, jnp.float32), jnp.asarray(0.0, jnp.float32))
    expected = [log_expected_improvement(float(value)) for value in z]
    np.testing.assert_allclose(found, expected, rtol=3e-7, atol=1e-3)
    for dtype, lowest in ((jnp.float32, -1e18), (jnp.float64, -1e150)):  # as far as it says
        one, zero = jnp.ones(1, dtype), jnp.zeros((), dtype)
        value = score(LogExpectedImprovement(zero), lowest * one, one, zero)
        np.testing.assert_allclose(value, -0.5 * lowest**2, rtol=1e-6)


@pytest.mark.parametrize("xi", [0.0, 0.3])
def test_probability_of_improvement_is_scored_by_its_logarithm(xi):
    mean, std, best = 0.7 + 2.0 * np.array(SCORES), np.full(16, 2.0), 0.7
    found = score(
        ProbabilityOfImprovement(jnp.asarray(xi)), jnp.asarray(mean), jnp.asarray(std), jnp.asarray(best)
    )
    np.testing.assert_allclose(found, stats.norm.logsf(best + xi, mean, std), rtol=1e-8)


def test_upper_confidence_bound_is_a_quantile():
    rng = np.random.default_rng(0)
    mean, std = rng.normal(size=50), rng.uniform(size=50)
    kappa = 1.7
    found = score(
        UpperConfidenceBound(jnp.asarray(kappa)), jnp.asarray(mean), jnp.asarray(std), jnp.asarray(9.0)
    )
    np.testing.assert_allclose(found, stats.norm.ppf(stats.norm.cdf(kappa), mean, std), rtol=1e-12)


def test_upper_confidence_bound_may_count_the_variance():
    mean, std = jnp.asarray([0.0, 1.0, 1.0]), jnp.asarray([0.5, 2.0, 0.0])
    acquisition = UpperConfidenceBound(jnp.asarray(3.0), "variance")
    np.testing.assert_allclose(score(acquisition, mean, std, jnp.asarray(9.0)), [0.75, 13.0, 1.0])


each_with_ties = pytest.mark.parametrize(
    "acquisition", [*ACQUISITIONS.values(), ExpectedImprovement(0.01)], ids=[*ACQUISITIONS, "ei"]
)
"""With the one whose score underflows to 0 far below the best value, where points are tied."""


@each_acquisition
def test_a_higher_mean_is_worth_more(acquisition):
    # Down to a standard score of -1e6; the changes of formula at -20 and -1 are crossed in steps of 1e-4.
    z = np.sort(np.concatenate([-np.logspace(6, 0, 2000), np.linspace(-26, 8, 340_000)]))
    values = np.asarray(score(acquisition, jnp.asarray(z), jnp.ones(z.size), jnp.asarray(0.0)))
    assert np.all(np.diff(values)[z[1:] < 5.0] > 0.0)
    assert np.all(np.diff(values) >= 0.0)  # a probability saturates at 1


@pytest.mark.parametrize("name", ["ucb", "log-ei"])
@pytest.mark.parametrize("mean", [-10.0, -1.0, 0.0, 1.0])
def test_more_uncertainty_is_worth_more(name, mean):
    std = jnp.asarray(np.logspace(-4, 4, 4000))
    values = np.asarray(score(ACQUISITIONS[name], jnp.full(4000, mean), std, jnp.asarray(0.0)))
    # Where the mean is above the best by many deviations, the improvement is the difference of the two.
    grows = np.diff(values)[np.asarray(std)[1:] > max(mean, 0.0) / 5.0]
    assert np.all(np.diff(values) >= -1e-14) and np.all(grows > 0.0)


@each_with_ties
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_scores_and_gradients_are_finite(acquisition, dtype):
    lowest = -1e12 if dtype == jnp.float32 else -1e140
    mean = jnp.asarray([lowest, -1e6, -20.0, -10.0, -1.0, 0.0, 0.01, 1.0, 25.0, 1e6], dtype)
    acquisition = jax.tree.map(lambda leaf: leaf.astype(dtype), acquisition)
    zero = jnp.zeros((), dtype)  # an observed point without noise has no spread
    assert np.all(np.isfinite(score(acquisition, mean[4:], jnp.zeros_like(mean[4:]), zero)))
    for std in (1.0, 1e-3):
        arguments = mean, jnp.full_like(mean, std), jnp.asarray(0.0, dtype)
        assert np.all(np.isfinite(score(acquisition, *arguments)))
        for gradient in gradients(acquisition, *arguments):
            assert np.all(np.isfinite(gradient))


@pytest.mark.parametrize("z", [-1e4, -30.0, -20.0, -19.9, -10.0, -1.0, 0.0, 3.0])
def test_gradients_of_log_expected_improvement_are_those_of_the_expectation(z):
    # With h(z) = E[max(z + e, 0)]: d log EI / d mean = Phi(z) / h(z) / std, d / d std = phi(z) / h(z) / std.
    std = 0.5
    acquisition = LogExpectedImprovement(jnp.asarray(0.0))
    by_mean, by_std = gradients(acquisition, jnp.asarray([z * std]), jnp.asarray([std]), jnp.asarray(0.0))
    log_h = log_expected_improvement(z)
    np.testing.assert_allclose(by_mean, np.exp(stats.norm.logcdf(z) - log_h) / std, rtol=1e-8)
    np.testing.assert_allclose(by_std, np.exp(stats.norm.logpdf(z) - log_h) / std, rtol=1e-8)
