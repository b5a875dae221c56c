"""What every path of every family is: a drive of the stated length from the pose along its heading."""

import jax
import numpy as np
import pytest
from scipy import stats

from bojax.motions.base import DiscreteMotions
from tests.motions.families import (
    FAMILIES,
    FINE,
    NUM_SAMPLES,
    all_paths,
    cubic,
    fine_paths,
    grid,
    kernel,
    paths_of,
    splines,
    wrapped,
)

CONTINUOUS = [name for name, motions in FAMILIES.items() if not isinstance(motions, DiscreteMotions)]
each_family = pytest.mark.parametrize("name", FAMILIES)
each_continuous_family = pytest.mark.parametrize("name", CONTINUOUS)


def chord_lengths(paths: np.ndarray) -> np.ndarray:
    """Of the chords between successive positions, the robot's own position first."""
    return np.linalg.norm(np.diff(paths[..., :2], axis=1, prepend=0.0), axis=-1)


@each_family
def test_poses_stand_at_equal_arc_lengths_of_a_path_of_the_stated_length_from_the_pose(name):
    length, chords = float(FAMILIES[name].length), chord_lengths(fine_paths(name))
    np.testing.assert_allclose(chords.sum(axis=1), length, rtol=2e-4)
    pieces = chords.reshape(-1, NUM_SAMPLES, FINE).sum(axis=-1)
    np.testing.assert_allclose(pieces, length / NUM_SAMPLES, rtol=3e-3)
    np.testing.assert_allclose(chords[:, 0], length / (FINE * NUM_SAMPLES), rtol=0.05)


@each_family
def test_the_number_of_samples_does_not_change_the_curve(name):
    np.testing.assert_allclose(fine_paths(name)[:, FINE - 1 :: FINE], all_paths(FAMILIES[name]), atol=1e-12)


@pytest.mark.parametrize("name", [name for name in FAMILIES if name != "kernel-relaxed"])
def test_every_path_starts_along_the_heading(name):
    early = fine_paths(name)[:, :2, 2]
    assert np.abs(early[:, 0]).max() < 5e-3  # after 1/2000 of the path
    # And it is the limit: half as far from the start, half as far from the heading.
    np.testing.assert_allclose(early[:, 0], 0.5 * early[:, 1], atol=1e-4)


@each_family
def test_the_heading_is_the_direction_of_travel(name):
    paths = fine_paths(name)
    chord = paths[:, 2:, :2] - paths[:, :-2, :2]
    direction = np.arctan2(chord[..., 1], chord[..., 0])
    assert np.abs(wrapped(paths[:, 1:-1, 2] - direction)).max() < 1e-3


@each_family
def test_no_path_folds_back(name):
    assert np.abs(wrapped(np.diff(fine_paths(name)[..., 2], axis=1))).max() < 0.05


@each_continuous_family
def test_negated_parameters_give_the_mirror_image(name):
    params = grid(FAMILIES[name])
    left, right = (np.asarray(paths_of(FAMILIES[name], p)) for p in (params, -params))
    np.testing.assert_allclose(right[..., 0], left[..., 0], atol=1e-12)
    np.testing.assert_allclose(right[..., 1], -left[..., 1], atol=1e-12)
    np.testing.assert_allclose(wrapped(right[..., 2] + left[..., 2]), 0.0, atol=1e-12)


@each_continuous_family
def test_different_parameters_give_different_paths(name):
    ends = all_paths(FAMILIES[name])[:, -1]
    apart = np.linalg.norm(ends[:, None] - ends[None, :], axis=-1)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() > 1e-3


@pytest.mark.parametrize("family", [splines, cubic, kernel])
def test_paths_grow_with_their_length(family):
    short, long = (family(5, length=v) if family is splines else family(length=v) for v in (1.0, 2.5))
    expected = all_paths(short) * [2.5, 2.5, 1.0]
    np.testing.assert_allclose(all_paths(long), expected, atol=1e-12)


def test_a_random_action_is_any_of_the_set():
    motions = splines(9)
    keys = jax.random.split(jax.random.key(0), 1800)
    drawn = np.asarray(jax.jit(jax.vmap(motions.sample))(keys))
    paths = all_paths(motions)
    apart = np.abs(drawn[:, None] - paths[None]).max(axis=(2, 3))
    which = np.argmin(apart, axis=1)
    assert apart.min(axis=1).max() < 1e-12
    assert stats.chisquare(np.bincount(which, minlength=9)).pvalue > 1e-3


def test_a_random_curve_has_uniform_parameters():
    motions = cubic()
    keys = jax.random.split(jax.random.key(0), 2000)
    end = np.asarray(jax.jit(jax.vmap(motions.sample))(keys))[:, -1]
    # The end's bearing and heading are the two parameters, see `CubicCurves`.
    bearing = np.arctan2(end[:, 1], end[:, 0])
    first, second = bearing / 0.8, wrapped(end[:, 2] - 2.0 * bearing) / 1.5
    for param in (first, second):
        assert stats.kstest(param, "uniform", args=(-1.0, 2.0)).pvalue > 1e-3
    assert abs(stats.spearmanr(first, second).statistic) < 0.08
