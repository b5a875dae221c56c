"""A sparse posterior is exact if all observations are inducing points, else the equation of its source."""

import jax
import jax.numpy as jnp
import numpy as np

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.models.sparse import JITTER, sparse_posterior, spread_inducing

KERNEL, NOISE = Scaled(Matern52(jnp.asarray(0.7)), jnp.asarray(1.5)), 0.02
QUERIES = np.random.default_rng(9).uniform(0.0, 4.0, (40, 2))


def data(number, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, 4.0, (number, 2))
    return x, np.sin(2.0 * x[:, 0]) + 0.3 * x[:, 1] + 0.1 * rng.standard_normal(number)


@jax.jit
def sparse(x, y, inducing, count=None):
    """Mean and variance of the sparse posterior at the queries."""
    return sparse_posterior(KERNEL, jnp.asarray(NOISE), x, y, inducing, count).predict(jnp.asarray(QUERIES))


@jax.jit
def exact(x, y):
    return GaussianProcess.fit(KERNEL, NOISE, x, y).predict(QUERIES)


def test_it_is_exact_with_an_inducing_point_for_each_observation():
    x, y = data(60)
    for one, other in zip(sparse(x, y, x), exact(x, y), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_it_is_the_equation_of_its_source():
    x, y = data(300)
    inducing = spread_inducing(x, 0.7, 50)
    grams = jax.jit(lambda *inputs: [KERNEL.gram(jnp.asarray(inducing), each) for each in inputs])
    gram, across, at = map(np.asarray, grams(inducing, x, QUERIES))
    gram = gram + 1.5 * JITTER * np.eye(50)
    sigma = np.linalg.inv(gram + across @ across.T / NOISE)
    mean = at.T @ sigma @ across @ y / NOISE
    variance = 1.5 - np.sum(at * np.linalg.solve(gram, at), axis=0) + np.sum(at * (sigma @ at), axis=0)
    found = sparse(x, y, inducing)
    np.testing.assert_allclose(found[0], mean, atol=1e-5)
    np.testing.assert_allclose(found[1], variance, atol=1e-5)


def test_more_inducing_points_come_closer_to_the_exact_posterior():
    x, y = data(1500)
    expected, errors = np.stack(exact(x, y)), []
    for number in (40, 120, 360):
        found = sparse(x, y, spread_inducing(x, 0.7, number))
        errors.append(np.abs(np.stack(found) - expected).max())
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2] and errors[2] < 0.02


def test_inducing_points_lie_everywhere_and_have_the_number():
    x = np.concatenate([data(500)[0], 0.001 * data(500, 1)[0]])  # half of them in one place
    inducing = spread_inducing(x, 0.7, 64)
    assert inducing.shape == (64, 2)
    gap = np.linalg.norm(x[:, None] - inducing[None], axis=-1).min(axis=1)
    assert gap.max() < 1.2


def test_rows_past_the_count_are_no_observations():
    x, y = data(100)
    inducing = spread_inducing(x, 0.7, 30)
    padded = np.concatenate([x, np.full((28, 2), 3.0)]), np.concatenate([y, np.full(28, 99.0)])
    found = sparse(*padded, inducing, jnp.asarray(100, jnp.int32))
    for one, other in zip(found, sparse(x, y, inducing), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
