"""Kernel trajectories against kernel Bayes' rule in NumPy, and what is imposed on them at the start."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

from bojax.models.kernels import RBF
from bojax.motions.kernel_trajectories import _uniform_embedding, posterior_coefficients
from tests.motions.families import FINE, NUM_SAMPLES, all_paths, fine_paths, grid, kernel, paths_of, wrapped
from tests.reference.kernel_trajectories import KernelTrajectory

SETTINGS = [(0.5, 0.7), (0.5, 0.3), (0.1, 0.5), (3.0, 1.0)]
"""Lengthscales in space and in time."""


@jax.jit
def coefficients_of(space, time, anchors, times):
    """The coefficients of the curve, by the kernels `space` and `time`."""
    grams = space.gram(anchors, anchors), time.gram(times[:, None], times[:, None])
    m_pi = _uniform_embedding(anchors, space.lengthscale)
    return posterior_coefficients(anchors, *grams, m_pi, jnp.asarray(0.1), jnp.asarray(1e-5))


def reference(params, space=0.5, time=0.7, start="pose") -> KernelTrajectory:
    return KernelTrajectory(params, 0.3, 1.0, space, time, epsilon=0.1, delta=1e-5, start=start)


def random_params(num: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (num, 3))


@pytest.mark.parametrize("space, time", SETTINGS)
def test_coefficients_are_kernel_bayes_rule_as_printed(space, time):
    for params in random_params(5):
        expected = reference(params, space, time)
        anchors = np.asarray(kernel().anchors(jnp.asarray(params)))
        np.testing.assert_allclose(anchors, expected.anchors, atol=1e-14)
        kernels = RBF(jnp.asarray(space)), RBF(jnp.asarray(time))
        coefficients = np.asarray(coefficients_of(*kernels, jnp.asarray(anchors), expected.times))
        for y in np.linspace(0.0, 1.0, 20):
            np.testing.assert_allclose(expected.k_y(y) @ coefficients, expected.expected(y), atol=1e-9)


@pytest.mark.parametrize("lengthscale", [0.1, 0.5, 2.0])
def test_the_embedding_of_the_uniform_prior_is_an_integral(lengthscale):
    points = np.array([[0.0, 0.0], [0.9, -0.4], [1.0, 1.0], [1.0, 0.0]])

    def by_axis(x):
        return integrate.quad(
            lambda u: 0.5 * np.exp(-0.5 * ((x - u) / lengthscale) ** 2), -1.0, 1.0, points=[x]
        )[0]

    found = _uniform_embedding(jnp.asarray(points), jnp.asarray(lengthscale))
    np.testing.assert_allclose(found, [by_axis(x) * by_axis(y) for x, y in points], rtol=1e-10)


@pytest.mark.parametrize("start", ["pose", "relaxed"])
def test_paths_follow_the_formulas(start):
    for space, time in ((0.5, 0.7), (1.0, 1.0)):
        motions, params = (
            kernel(start=start, space_lengthscale=space, time_lengthscale=time),
            random_params(6),
        )
        for path, each in zip(paths_of(motions, jnp.asarray(params)), params, strict=True):
            expected = reference(each, space, time, start).path(1.0, NUM_SAMPLES)
            # The arc length of bojax is a trapezoid rule over 65 knots, that of the reference 2000 chords.
            np.testing.assert_allclose(path, expected, rtol=0.0, atol=2e-4)


def test_a_relaxed_path_starts_at_the_pose_but_not_along_the_heading():
    first = fine_paths("kernel-relaxed")[:, 0]
    assert np.linalg.norm(first[:, :2], axis=-1).max() < 1.05 / 2000
    assert np.median(np.abs(first[:, 2])) > np.radians(10.0)
    # It turns at once towards the side of its first two anchors.
    velocities = [reference(params, start="relaxed").velocity(0.0) for params in np.asarray(grid(kernel()))]
    np.testing.assert_allclose(first[:, 2], [np.arctan2(y, x) for x, y in velocities], atol=5e-3)


def test_the_restriction_of_the_start_keeps_the_end():
    restricted, relaxed = (all_paths(kernel(start=start))[:, -1] for start in ("pose", "relaxed"))
    np.testing.assert_allclose(wrapped(restricted[:, 2] - relaxed[:, 2]), 0.0, atol=1e-12)
    bearings = (np.arctan2(end[:, 1], end[:, 0]) for end in (restricted, relaxed))
    np.testing.assert_allclose(wrapped(np.subtract(*bearings)), 0.0, atol=1e-12)


@pytest.mark.parametrize("time_lengthscale, folds", [(0.2, True), (0.7, False)])
def test_a_short_lengthscale_in_time_folds_the_path_back(time_lengthscale, folds):
    # What limits the choice of the time kernel: between the anchors the curve falls back to where it was.
    heading = all_paths(kernel(time_lengthscale=time_lengthscale), FINE * NUM_SAMPLES)[..., 2]
    turns = np.abs(wrapped(np.diff(heading, axis=1))).max(axis=1)
    assert np.any(turns > 3.0) == folds
