"""Draws of a posterior have its mean and covariance, and a search by them finds a maximum."""

from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.acquisition.bayesian_optimisation import BayesianOptimisation
from bojax.acquisition.thompson import ThompsonSampling
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Matern52, Scaled
from bojax.models.means import ConstantMean
from tests.refusals import assert_refused

POINTS = jnp.asarray([[-0.7, 0.1], [0.1, 0.2], [0.3, -0.9]])
NUM_DRAWS = 4000


@jax.jit
def process(noise_variance):
    x = jax.random.uniform(jax.random.key(0), (5, 2), minval=-1.0, maxval=1.0)
    y = jnp.sin(3.0 * x[:, 0]) + x[:, 1]
    kernel = Scaled(Matern52(0.8), 2.0)
    return GaussianProcess.fit(kernel, noise_variance, x, y, mean=ConstantMean(0.5), capacity=7)


@eqx.filter_jit
def values(gp, keys, xs):
    sampling = ThompsonSampling(num_features=64)
    return jax.vmap(lambda key: sampling.draw(key, gp).predict(xs)[0])(keys)


@pytest.mark.parametrize("noise_variance", [0.3, 1e-6])
def test_draws_have_the_moments_of_the_posterior(noise_variance):
    gp = process(jnp.asarray(noise_variance))
    mean, covariance = (np.asarray(each) for each in jax.jit(type(gp).predict_covariance)(gp, POINTS))
    draws = np.asarray(values(gp, jax.random.split(jax.random.key(1), NUM_DRAWS), POINTS))
    # Five standard errors: of a mean, and of a covariance of normal variables.
    variance = np.diag(covariance)
    assert np.all(np.abs(draws.mean(axis=0) - mean) <= 5.0 * np.sqrt(variance / NUM_DRAWS))
    errors = np.sqrt((np.outer(variance, variance) + covariance**2) / NUM_DRAWS)
    assert np.all(np.abs(np.cov(draws.T) - covariance) <= 5.0 * errors)


def test_a_draw_without_noise_passes_through_the_observations():
    gp = process(jnp.asarray(0.0))
    draws = values(gp, jax.random.split(jax.random.key(2), 3), gp.x[:5])
    errors = np.abs(np.asarray(draws) - np.asarray(gp.y[:5]))
    floor = jax.jit(lambda gp: gp.noise(gp.x[:5]))(gp)
    assert np.all(errors <= 5.0 * np.sqrt(floor))


@eqx.filter_jit
def maximise(search, keys):
    def peak(key, x):
        return jnp.exp(-4.0 * jnp.sum((x - 0.4) ** 2)) + 0.01 * jax.random.normal(key)

    return jax.vmap(lambda key: search.maximise(key, peak, search.capacity))(keys)


@eqx.filter_jit
def scores(search, state, grid):
    later = search.tell(state, jnp.asarray([0.4]), 1.0)
    return search.score(state, grid), search.score(later, grid), search.score(state, search.ask(state)[None])


def test_a_search_by_draws_finds_the_peak():
    search = BayesianOptimisation(
        kernel=RBF(0.5),
        acquisition=ThompsonSampling(num_features=64),
        noise_variance=1e-4,
        low=[0.0],
        high=[1.0],
        capacity=12,
        num_candidates=64,
        refine_steps=0,
    )
    states, _, ys = maximise(search, jax.random.split(jax.random.key(3), 8))
    assert np.all(np.asarray(ys).max(axis=1) > 0.95)
    # The next point maximises what `score` shows, and another draw is made after every evaluation.
    state = jax.tree.map(lambda leaf: leaf[0], states)
    now, later, asked = scores(search, state, jnp.linspace(0.0, 1.0, 65)[:, None])
    assert float(asked[0]) >= float(np.sort(now)[-3])  # candidates and grid differ
    assert not np.allclose(now, later)


def test_what_is_no_thompson_sampling_is_refused():
    five = lambda: BayesianOptimisation("rbf", cast(Any, 5), 0.1, [0.0], [1.0], capacity=3)  # noqa: E731
    odd = [(lambda n=n: ThompsonSampling(n), "^num_features: got .*; allowed: ") for n in (0, 3)]
    assert_refused([(five, "acquisition: got 5; allowed: an instance of Acquisition"), *odd])
