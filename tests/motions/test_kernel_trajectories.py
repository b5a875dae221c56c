"""Kernel trajectories against kernel Bayes' rule in NumPy, and what is imposed on them at the start."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

from bojax.models.kernels import RBF
from bojax.motions.kernel_trajectories import _uniform_embedding, posterior_coefficients
from tests.motions import kernel_bayes_rule as reference
from tests.motions.families import FINE, NUM_SAMPLES, all_paths, fine_paths, grid, kernel, wrapped

SETTINGS = [(0.5, 0.7), (0.5, 0.3), (0.1, 0.5), (3.0, 1.0)]
"""Lengthscales in space and in time."""

TIMES = np.linspace(0.0, 1.0, 4)


@jax.jit
def coefficients_of(space, time, anchors, times, m_pi):
    """The coefficients of the curve, by the kernels `space` and `time`."""
    grams = space.gram(anchors, anchors), time.gram(times, times)
    return posterior_coefficients(anchors, *grams, m_pi, jnp.asarray(0.1), jnp.asarray(1e-5))


def anchors_of(params, **changes) -> np.ndarray:
    return np.asarray(kernel(**changes).anchors(jnp.asarray(params)))


def embedding(anchors: np.ndarray, lengthscale: float) -> np.ndarray:
    return np.asarray(_uniform_embedding(jnp.asarray(anchors), jnp.asarray(lengthscale)))


def raw_curve(ys, params, space_lengthscale=0.5, time_lengthscale=0.7, **angles) -> np.ndarray:
    """The curve of (4.7), before anything is imposed on its start."""
    anchors = anchors_of(params, **angles)
    m_pi = embedding(anchors, space_lengthscale)
    return reference.trajectory(ys, anchors, TIMES, m_pi, space_lengthscale, time_lengthscale, 0.1, 1e-5)


@pytest.mark.parametrize("params", [[0.0, 0.0, 0.0], [1.0, -1.0, 0.5], [-0.3, 0.8, 0.2]])
def test_anchors_are_a_chain_of_equal_segments_that_turn(params):
    anchors = anchors_of(params)
    np.testing.assert_array_equal(anchors[0], [0.0, 0.0])
    segments = np.diff(anchors, axis=0)
    np.testing.assert_allclose(np.linalg.norm(segments, axis=-1), 1.0 / 3.0, rtol=1e-14)
    headings = np.arctan2(segments[:, 1], segments[:, 0])
    np.testing.assert_allclose(
        np.diff(headings, prepend=0.0), np.multiply(params, [0.3, 1.0, 1.0]), atol=1e-14
    )


@pytest.mark.parametrize("space_lengthscale, time_lengthscale", SETTINGS)
def test_coefficients_are_kernel_bayes_rule_as_printed(space_lengthscale, time_lengthscale):
    rng = np.random.default_rng(0)
    ys = rng.uniform(0.0, 1.0, 20)
    for _ in range(5):
        anchors, m_pi = rng.uniform(-1.0, 1.0, (4, 2)), rng.uniform(0.1, 1.0, 4)
        space, time = RBF(jnp.asarray(space_lengthscale)), RBF(jnp.asarray(time_lengthscale))
        coefficients = coefficients_of(space, time, jnp.asarray(anchors), TIMES[:, None], jnp.asarray(m_pi))
        found = reference.rbf(ys[:, None], TIMES[:, None], time_lengthscale) @ np.asarray(coefficients)
        expected = reference.trajectory(
            ys, anchors, TIMES, m_pi, space_lengthscale, time_lengthscale, 0.1, 1e-5
        )
        np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("lengthscale", [0.1, 0.5, 2.0])
def test_the_embedding_of_the_uniform_prior_is_an_integral(lengthscale):
    points = np.array([[0.0, 0.0], [0.9, -0.4], [1.0, 1.0], [1.5, 0.0]])  # the last one is outside

    def by_axis(x):
        return integrate.quad(
            lambda u: 0.5 * np.exp(-0.5 * ((x - u) / lengthscale) ** 2), -1.0, 1.0, points=[x]
        )[0]

    expected = [by_axis(x) * by_axis(y) for x, y in np.clip(points, -1.0, 1.0)]
    inside = np.clip(points, -1.0, 1.0)
    np.testing.assert_allclose(embedding(inside, lengthscale), expected, rtol=1e-10)


@pytest.mark.parametrize("lengthscale", [0.2, 0.5, 2.0])
def test_the_embedding_is_the_limit_of_samples_of_the_prior(lengthscale):
    num = 200_000
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (num, 2))
    anchors = anchors_of([0.5, -1.0, 0.3])
    values = reference.rbf(anchors, points, lengthscale)
    error = values.mean(axis=1) - embedding(anchors, lengthscale)
    assert np.all(np.abs(error) < 4.0 * values.std(axis=1) / num**0.5)


@pytest.mark.parametrize("space_lengthscale, time_lengthscale", [(0.5, 0.7), (1.0, 1.0)])
def test_a_path_is_the_expected_trajectory_with_its_start_moved_onto_the_pose(
    space_lengthscale, time_lengthscale
):
    params = np.asarray(grid(kernel()))[17]
    changes = {"space_lengthscale": space_lengthscale, "time_lengthscale": time_lengthscale}
    ys = np.linspace(0.0, 1.0, 2001)
    raw = raw_curve(ys, params, space_lengthscale, time_lengthscale)
    velocity = (4.0 * raw[1] - 3.0 * raw[0] - raw[2]) / (2.0 * ys[1])
    curve = raw - raw[0] + (ys * (1.0 - ys) ** 2)[:, None] * (np.array([1.0, 0.0]) - velocity)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=-1))])
    at = np.interp(arc[-1] * np.arange(1, 9) / 8, arc, ys)
    expected = np.stack([np.interp(at, ys, curve[:, axis]) for axis in range(2)], axis=-1) / arc[-1]
    path = all_paths(kernel(**changes))[17]
    np.testing.assert_allclose(path[:, :2], expected, atol=5e-4)


def test_without_the_restriction_a_trajectory_misses_the_pose():
    # Why the start is imposed: the regularised curve begins millimetres to centimetres off the robot and
    # tens of degrees off its heading.
    starts, angles = [], []
    for params in np.asarray(grid(kernel(), levels=3)):
        raw = raw_curve(np.array([0.0, 1e-5]), params)
        direction = raw[1] - raw[0]
        starts.append(np.linalg.norm(raw[0]))
        angles.append(abs(np.degrees(np.arctan2(direction[1], direction[0]))))
    assert 0.005 < np.median(starts) < 0.02 and max(starts) < 0.05
    assert np.median(angles) > 10.0 and 30.0 < max(angles) < 60.0


def test_one_more_anchor_at_the_start_does_not_do():
    # An anchor along the heading shortly after the start, as others have added, leaves the tangent as it is.
    anchors = anchors_of([1.0, 1.0, 1.0], first_angle=0.25 * np.pi, turn_angle=0.4 * np.pi)
    anchors = np.insert(anchors, 1, [0.01, 0.0], axis=0)
    times = np.insert(TIMES, 1, 0.01)
    raw = reference.trajectory(
        np.array([0.0, 1e-5]), anchors, times, embedding(anchors, 0.5), 0.5, 0.7, 0.1, 1e-5
    )
    direction = raw[1] - raw[0]
    assert np.linalg.norm(raw[0]) > 1e-3
    assert np.degrees(np.arctan2(direction[1], direction[0])) > 20.0


def test_a_relaxed_path_starts_at_the_pose_but_not_along_the_heading():
    first = fine_paths("kernel-relaxed")[:, 0]
    assert np.linalg.norm(first[:, :2], axis=-1).max() < 1.05 / 2000
    assert np.median(np.abs(first[:, 2])) > np.radians(10.0)
    # It turns at once towards the side of its first two anchors.
    raw = [np.diff(raw_curve(np.array([0.0, 1e-5]), p), axis=0)[0] for p in np.asarray(grid(kernel()))]
    np.testing.assert_allclose(first[:, 2], [np.arctan2(y, x) for x, y in raw], atol=5e-3)


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
