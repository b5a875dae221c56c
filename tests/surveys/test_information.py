"""The error that a route leaves equals the posterior of scikit-learn given all samples at once."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.surveys.information import PointErrors, left_by, path_length, points_at, samples_along

VARIANCE, LENGTHSCALE, NOISE, SPACING = 0.8, 1.2, 0.01, 0.4
ROUTE = np.array([[0.5, 0.5], [3.0, 0.5], [3.0, 2.1], [0.5, 3.5]])
GRID = np.stack(np.meshgrid(np.linspace(0, 4, 5), np.linspace(0, 4, 5)), axis=-1).reshape(-1, 2)
DATA = np.array([[2.0, 3.0], [3.5, 3.5], [0.2, 2.0]])


@jax.jit
def errors_of_grid():
    return PointErrors.of(belief(DATA), jnp.asarray(GRID))


@partial(jax.jit, static_argnums=1)
def belief(data, capacity=8):
    kernel = Scaled(Matern52(jnp.asarray(LENGTHSCALE)), jnp.asarray(VARIANCE))
    return GaussianProcess.fit(kernel, NOISE, data, np.zeros(len(data)), capacity=capacity)


@partial(jax.jit, static_argnums=2)
def left_after(errors, route, number):
    """The error after `number` samples of a route."""
    return errors.after(*samples_along(route, SPACING, number))


def walked(route, distances):
    """Points of a polyline at these distances."""
    ends = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1)))
    return np.stack([np.interp(distances, ends, route[:, axis]) for axis in (0, 1)], axis=-1)


def deviation(samples):
    model = GaussianProcessRegressor(
        ConstantKernel(VARIANCE, "fixed") * Matern(LENGTHSCALE, "fixed", nu=2.5), alpha=NOISE
    )
    model.fit(np.concatenate([DATA, samples]), np.zeros(len(DATA) + len(samples)))
    return np.asarray(model.predict(GRID, return_std=True))[1]


def test_samples_lie_at_their_distances_along_the_route():
    distances = np.array([0.0, 0.3, 2.5, 3.9, 4.2, 6.0, 99.0])
    found = jax.jit(points_at)(jnp.asarray(ROUTE), jnp.asarray(distances))
    np.testing.assert_allclose(found, walked(ROUTE, distances), atol=1e-12)


def test_the_error_after_each_sample_is_the_one_of_scikit_learn():
    route = jnp.asarray(ROUTE)
    number = int(float(path_length(route)) / SPACING)
    taken, samples = samples_along(route, SPACING, number), walked(ROUTE, SPACING * np.arange(1, number + 1))
    deviations, variances = left_by(errors_of_grid(), *taken)
    expected = [deviation(samples[:count]) for count in range(number + 1)]
    np.testing.assert_allclose(deviations, [each.mean() for each in expected], rtol=1e-8)
    np.testing.assert_allclose(variances, expected[-1] ** 2, rtol=1e-8)
    weights = np.where(GRID[:, 0] < 2.0, 3.0, 0.0)
    deviations, _ = left_by(PointErrors.of(belief(DATA), jnp.asarray(GRID), jnp.asarray(weights)), *taken)
    np.testing.assert_allclose(deviations[-1], expected[-1][GRID[:, 0] < 2.0].mean(), rtol=1e-8)


def test_samples_beyond_the_end_of_a_route_teach_nothing():
    errors, route = errors_of_grid(), jnp.asarray(ROUTE)
    on_route = int(float(path_length(route)) / SPACING)
    beyond, on = (left_after(errors, route, number) for number in (on_route + 7, on_route))
    np.testing.assert_allclose(beyond, on, rtol=1e-12)


def test_the_gradient_of_the_loss_is_its_slope():
    errors = errors_of_grid()

    def loss(route):
        return left_after(errors, route, 14)

    gradient = jax.jit(jax.grad(loss))(jnp.asarray(ROUTE))
    step = 1e-6
    for index in np.ndindex(ROUTE.shape):
        away = np.zeros_like(ROUTE)
        away[index] = step
        slope = (loss(jnp.asarray(ROUTE + away)) - loss(jnp.asarray(ROUTE - away))) / (2 * step)
        np.testing.assert_allclose(gradient[index], slope, atol=1e-7)


def test_a_batch_of_routes_is_a_loop_over_them():
    errors, routes = errors_of_grid(), np.stack([ROUTE, ROUTE[::-1], ROUTE + 0.3])
    batch = jax.jit(jax.vmap(lambda route: left_after(errors, route, 14)))(routes)
    each = [left_after(errors, jnp.asarray(route), 14) for route in routes]
    np.testing.assert_allclose(batch, each, rtol=1e-12)
