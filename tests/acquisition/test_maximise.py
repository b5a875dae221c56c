"""The best of many candidates, and its refinement by signed gradient steps."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.acquisition.functions import LogExpectedImprovement, ProbabilityOfImprovement, UpperConfidenceBound
from bojax.acquisition.maximise import best_candidate, refine
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Matern12
from bojax.numerics.quasirandom import shifted_kronecker

ACQUISITIONS = [
    UpperConfidenceBound(jnp.asarray(2.0)),
    ProbabilityOfImprovement(jnp.asarray(0.01)),
    LogExpectedImprovement(jnp.asarray(0.01)),
]
each_acquisition = pytest.mark.parametrize("acquisition", ACQUISITIONS, ids=lambda a: type(a).__name__)


def posterior(x, y, kernel=None, noise_variance=0.01) -> GaussianProcess:
    """The posterior after the given observations, with room for one more."""
    kernel = RBF(jnp.asarray(0.5)) if kernel is None else kernel
    gp = GaussianProcess.prior(kernel, jnp.asarray(noise_variance), len(y) + 1, num_dims=2)
    for point, value in zip(jnp.asarray(x), jnp.asarray(y), strict=True):
        gp = condition(gp, point, value)
    return gp


@jax.jit
def condition(gp, x, y):
    return gp.update(x, y)


def random_posterior(seed: int = 0, kernel=None) -> GaussianProcess:
    rng = np.random.default_rng(seed)
    return posterior(rng.uniform(-1.0, 1.0, (6, 2)), rng.normal(size=6), kernel)


candidates_of = functools.partial(shifted_kronecker, num_points=200, num_dims=2, dtype=jnp.float64)
best_of = jax.jit(best_candidate)
refined = jax.jit(
    lambda acquisition, gp, best, starts, num_steps: jax.vmap(
        lambda start: refine(acquisition, gp, best, start, num_steps)
    )(starts),
    static_argnums=4,
)


@jax.jit
def value(acquisition, gp, best, xs):
    """Acquisition at the points `xs`."""
    mean, variance = gp.predict(xs)
    return acquisition(mean, jnp.sqrt(variance), best)


@each_acquisition
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_best_candidate_is_found_by_looking_at_each(acquisition, seed):
    gp, candidates = random_posterior(seed), candidates_of(jax.random.key(seed))
    best = jnp.max(gp.y)
    index, _ = best_of(acquisition, gp, best, candidates)
    one_by_one = [float(value(acquisition, gp, best, x[None])[0]) for x in candidates]
    assert index == np.argmax(one_by_one)


def test_of_equal_candidates_the_first_is_the_best():
    gp = GaussianProcess.prior(RBF(jnp.asarray(0.5)), jnp.asarray(0.01), 3, num_dims=2)
    index, _ = best_of(ACQUISITIONS[0], gp, jnp.asarray(0.0), candidates_of(jax.random.key(0)))
    assert index == 0


def test_the_whitened_candidates_give_the_update():
    gp, candidates = random_posterior(), candidates_of(jax.random.key(4))
    index, whitened = best_of(ACQUISITIONS[0], gp, jnp.asarray(0.0), candidates)
    row = gp.next_row(candidates[index], whitened[:, index])
    updated = condition(gp, candidates[index], jnp.asarray(0.3))
    np.testing.assert_allclose(updated.inverse_cholesky[6], row, atol=1e-13)


@each_acquisition
@pytest.mark.parametrize("kernel", [RBF(jnp.asarray(0.5)), Matern12(jnp.asarray([0.2, 2.0]))])
def test_a_refined_point_is_in_the_box_and_never_worse_than_its_start(acquisition, kernel):
    gp = random_posterior(3, kernel)
    best = jnp.max(gp.y)
    corners = jnp.asarray([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    starts = jnp.concatenate([candidates_of(jax.random.key(5)), corners, gp.x[:6]])
    ends = refined(acquisition, gp, best, starts, 15)
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
    starts = jnp.asarray(centre + 0.3 * np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2)))
    ends = refined(UpperConfidenceBound(jnp.asarray(kappa)), gp, jnp.asarray(1.0), starts, 40)
    np.testing.assert_allclose(ends, np.broadcast_to(centre, ends.shape), atol=1e-3)


def test_refinement_climbs_to_a_border_and_stays():
    gp = posterior([[1.0, 0.0], [-1.0, 0.0]], [1.0, -1.0], RBF(jnp.asarray(3.0)))
    starts = jnp.asarray(np.random.default_rng(0).uniform(-1.0, 1.0, (20, 2)))
    ends = refined(UpperConfidenceBound(jnp.asarray(0.0)), gp, jnp.asarray(1.0), starts, 60)
    np.testing.assert_allclose(ends, np.broadcast_to([1.0, 0.0], ends.shape), atol=1e-3)


def test_refinement_without_steps_is_the_start():
    gp, starts = random_posterior(), candidates_of(jax.random.key(6))
    np.testing.assert_array_equal(refined(ACQUISITIONS[0], gp, jnp.asarray(0.0), starts, 0), starts)


def test_where_the_posterior_is_flat_nothing_moves():
    gp = GaussianProcess.prior(RBF(jnp.asarray(0.5)), jnp.asarray(0.01), 7, num_dims=2)
    starts = candidates_of(jax.random.key(7))
    np.testing.assert_array_equal(refined(ACQUISITIONS[0], gp, jnp.asarray(0.0), starts, 15), starts)
