"""Least squares and its ridge against NumPy, scikit-learn, and the geometry of projections."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.linear_model import LinearRegression as Reference
from sklearn.linear_model import Ridge

from bojax.models.linear_regression import LinearRegression
from tests.refusals import assert_refused

fit = jax.jit(LinearRegression.fit)
fit_map = jax.jit(LinearRegression.fit_map)


def problem(num: int, num_features: int, num_targets: tuple[int, ...] = (), seed: int = 0):
    rng = np.random.default_rng(seed)
    return jnp.asarray(rng.normal(size=(num, num_features))), jnp.asarray(
        rng.normal(size=(num, *num_targets))
    )


@pytest.mark.parametrize("num_targets", [(), (3,)])
def test_is_the_least_squares_of_scikit_learn(num_targets):
    features, targets = problem(30, 5, num_targets)
    model = fit(features, targets)
    expected = Reference(fit_intercept=False).fit(features, targets)
    np.testing.assert_allclose(model.weights, expected.coef_.T, rtol=1e-12)
    np.testing.assert_allclose(model.predict(features), expected.predict(features), rtol=1e-11)


def test_does_not_square_the_condition_number():
    # Condition number 1e10: the normal equations (2.8), taken literally, know nothing of the last weight.
    rng = np.random.default_rng(0)
    u, _ = np.linalg.qr(rng.normal(size=(40, 4)))
    v, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    features, weights = u * 10.0 ** np.asarray([0, -3, -6, -10]) @ v.T, np.ones(4)
    targets = features @ weights
    found = fit(jnp.asarray(features), jnp.asarray(targets)).weights
    np.testing.assert_allclose(found, weights, atol=1e-4)
    normal = np.linalg.solve(features.T @ features, features.T @ targets)
    assert np.abs(normal - weights).max() > 1e-2


@pytest.mark.parametrize("num, num_features", [(20, 6), (4, 6), (1, 3)])
def test_of_equally_good_weights_it_takes_the_shortest(num, num_features):
    features, targets = problem(num, num_features)
    features = features.at[:, -1].set(features[:, 0])  # the same feature twice: rank deficient
    found = fit(features, targets).weights
    np.testing.assert_allclose(found, np.linalg.lstsq(features, targets)[0], atol=1e-12)
    np.testing.assert_allclose(found[-1], found[0], atol=1e-12)


@pytest.mark.parametrize("num_targets", [(), (2,)])
def test_without_observations_or_signal_the_weights_are_zero(num_targets):
    for features, targets in (problem(0, 3, num_targets), problem(5, 3, num_targets)):
        assert not np.any(fit(0.0 * features, targets).weights)
        assert not np.any(fit(features, 0.0 * targets).weights)


@pytest.mark.parametrize("num", [0, 1, 30])
@pytest.mark.parametrize("prior_precision, noise_precision", [(0.1, 1.0), (2.0, 25.0), (1e6, 1e-6)])
def test_the_map_estimate_is_ridge_regression(num, prior_precision, noise_precision):
    features, targets = problem(num, 5, (2,))
    found = fit_map(features, targets, jnp.asarray(prior_precision), jnp.asarray(noise_precision)).weights
    if num:
        ridge = Ridge(prior_precision / noise_precision, fit_intercept=False, solver="svd")
        np.testing.assert_allclose(found, ridge.fit(features, targets).coef_.T, rtol=1e-7)
    else:
        np.testing.assert_array_equal(found, np.zeros((5, 2)))


def test_lists_are_as_good_as_arrays():
    features, targets = [[1, 0], [1, 1], [1, 2]], [0, 1, 2]
    np.testing.assert_allclose(LinearRegression.fit(features, targets).predict([[1, 5]]), [5], rtol=1e-12)
    ridge = LinearRegression.fit_map(features, targets, 3, 2)
    gram = np.asarray(features).T @ features + 1.5 * np.eye(2)
    np.testing.assert_allclose(ridge.weights, np.linalg.solve(gram, np.asarray(features).T @ targets))


def test_outside_of_jit_what_has_no_solution_is_refused():
    fit, fit_map, holed = (
        LinearRegression.fit,
        LinearRegression.fit_map,
        "targets: 1 of 2 numbers are not finite",
    )
    assert_refused(
        [
            (lambda: fit([[1], [2]], [1, np.nan]), holed),
            (lambda: fit_map([[1], [2]], [1, np.inf], 1, 1), holed),
            (lambda: fit_map([[1], [2]], [1, 2], -1, 1), "prior_precision: got -1.0; allowed: a number > 0"),
            (lambda: fit_map([[1], [2]], [1, 2], 1, 0), "noise_precision: got 0.0; allowed: a number > 0"),
        ]
    )
