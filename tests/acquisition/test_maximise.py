"""The best of many candidates, and its refinement by signed gradient steps."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.acquisition.functions import UpperConfidenceBound
from bojax.acquisition.maximise import best_candidate, first_maximum, refine
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Matern12
from tests.acquisition.cases import ACQUISITIONS, each_acquisition

CAPACITY = 8
NUM_STEPS = 40


@jax.jit
def condition(gp, x, y):
    return gp.update(x, y)


def test_the_first_maximum_is_that_of_numpy():
    scores = np.random.default_rng(0).integers(0, 5, (40, 48)).astype(float)  # maxima are tied
    scores[::4, 30] = np.nan
    scores[1::4, 20:40] = np.inf
    scores[2] = -np.inf
    for number in (48, 45):  # with columns, and without
        found = jax.jit(jax.vmap(first_maximum))(jnp.asarray(scores[:, :number]))
        np.testing.assert_array_equal(found, np.argmax(scores[:, :number], axis=1))


def posterior(x, y, kernel=None, noise_variance=0.01) -> GaussianProcess:
    """The posterior after the given observations."""
    kernel = RBF(jnp.asarray(0.5)) if kernel is None else kernel
    gp = GaussianProcess.prior(kernel, jnp.asarray(noise_variance), CAPACITY, num_dims=2)
    for point, value in zip(jnp.asarray(x), jnp.asarray(y), strict=True):
        gp = condition(gp, point, value)
    return gp


def random_posterior(seed: int = 0, kernel=None) -> GaussianProcess:
    rng = np.random.default_rng(seed)
    return posterior(rng.uniform(-1.0, 1.0, (6, 2)), rng.normal(size=6), kernel)


def random_points(seed: int = 0):
    return jnp.asarray(np.random.default_rng(seed).uniform(-1.0, 1.0, (200, 2)))


@jax.jit
def best_of(acquisition, gp, best, candidates):
    return best_candidate(acquisition, gp, best, candidates, gp.whiten(candidates))


@functools.partial(jax.jit, static_argnames="num_steps")
def refined(acquisition, gp, best, starts, num_steps=NUM_STEPS):
    """Where the refinement of each start ends."""
    return jax.vmap(lambda start: refine(acquisition, gp, best, start, num_steps))(starts)


@jax.jit
def value(acquisition, gp, best, xs):
    """Acquisition at the points `xs`."""
    mean, variance = gp.predict(xs)
    return acquisition(mean, jnp.sqrt(variance), best)


@each_acquisition
def test_the_best_candidate_is_found_by_looking_at_each(acquisition):
    for seed in range(3):
        gp, candidates = random_posterior(seed), random_points(seed)
        best = jnp.max(gp.y)
        index = best_of(acquisition, gp, best, candidates)
        one_by_one = [float(value(acquisition, gp, best, x[None])[0]) for x in candidates]
        assert index == np.argmax(one_by_one)


@pytest.mark.parametrize(
    "name, kernel",
    [
        ("ucb", RBF(jnp.asarray(0.5))),
        ("pi", Matern12(jnp.asarray(0.7))),
        ("log-ei", RBF(jnp.asarray([0.2, 2.0]))),
    ],
)
def test_a_refined_point_is_in_the_box_and_never_worse_than_its_start(name, kernel):
    acquisition = ACQUISITIONS[name]
    gp = random_posterior(3, kernel)
    best = jnp.max(gp.y)
    corners = jnp.asarray([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    starts = jnp.concatenate([corners, gp.x[:6], random_points()[:190]])
    ends = refined(acquisition, gp, best, starts)
    assert np.all(np.abs(ends) <= 1.0)
    gains = np.asarray(value(acquisition, gp, best, ends) - value(acquisition, gp, best, starts))
    assert np.all(gains >= -1e-12)
    assert np.mean(gains > 0.0) > 0.8


@pytest.mark.parametrize("kappa", [0.0, 0.5])
def test_refinement_climbs_the_only_peak(kappa):
    # One high observation inside a ring of low ones: a single hill, with its top at the centre of the ring.
    centre = np.array([0.3, -0.2])
    angles = 2.0 * np.pi * np.arange(6) / 6
    ring = centre + 0.5 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    gp = posterior(np.concatenate([[centre], ring]), [1.0] + [0.0] * 6)
    starts = jnp.asarray(centre + 0.3 * np.asarray(random_points()))
    ends = refined(UpperConfidenceBound(jnp.asarray(kappa)), gp, jnp.asarray(1.0), starts)
    np.testing.assert_allclose(ends, np.broadcast_to(centre, ends.shape), atol=1e-3)


def test_refinement_climbs_to_a_border_and_stays():
    gp = posterior([[1.0, 0.0], [-1.0, 0.0]], [1.0, -1.0], RBF(jnp.asarray(3.0)))
    ends = refined(UpperConfidenceBound(jnp.asarray(0.0)), gp, jnp.asarray(1.0), random_points())
    np.testing.assert_allclose(ends, np.broadcast_to([1.0, 0.0], ends.shape), atol=2e-3)


def test_where_the_posterior_is_flat_nothing_moves():
    starts = random_points()
    ends = refined(ACQUISITIONS["ucb"], posterior([], []), jnp.asarray(0.0), starts)
    np.testing.assert_array_equal(ends, starts)
