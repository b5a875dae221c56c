"""The spline sets of 5, 9 and 17 actions, and the cubic curves."""

import jax.numpy as jnp
import numpy as np
import pytest

from tests.motions.families import all_paths, cubic, paths_of, splines, wrapped


@pytest.mark.parametrize("actions", [5, 9, 17])
def test_a_set_has_its_number_of_actions_all_distinct(actions):
    motions = splines(actions)
    paths = all_paths(motions)
    assert motions.num_actions == actions
    assert paths.shape == (actions, 8, 3)
    apart = np.linalg.norm(paths[:, None, -1] - paths[None, :, -1], axis=-1)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() > 0.03


@pytest.mark.parametrize("smaller, larger", [(5, 9), (9, 17)])
def test_a_larger_set_begins_with_the_smaller_one(smaller, larger):
    np.testing.assert_allclose(
        all_paths(splines(larger))[:smaller], all_paths(splines(smaller)), rtol=0, atol=1e-14
    )


def test_a_set_with_room_has_the_paths_of_the_largest():
    roomy = splines(5).with_room()
    assert (roomy.num_actions, int(roomy.count), int(roomy.with_room().count)) == (17, 5, 5)
    np.testing.assert_array_equal(all_paths(roomy), all_paths(splines(17)))


@pytest.mark.parametrize("actions", [5, 9, 17])
def test_a_set_is_straight_on_and_pairs_of_mirror_images(actions):
    straight, *turns = all_paths(splines(actions))
    np.testing.assert_allclose(straight[:, 1:], 0.0, atol=1e-15)
    for left, right in zip(turns[::2], turns[1::2], strict=True):
        assert left[-1, 1] > 0.0 and left[-1, 2] > 0.0
        np.testing.assert_allclose(right, left * [1.0, -1.0, -1.0], atol=1e-13)


def test_a_rotated_spline_is_the_published_one_but_for_its_start():
    # x = 0.55 u, y = 0.5 u^2 - 0.1 u: rotated by atan(0.1 / 0.55) = 10.3 degrees and scaled.
    u = np.linspace(0.0, 1.0, 20_001)
    curve = np.stack([0.55 * u, 0.5 * u**2 - 0.1 * u], axis=-1)
    arc = np.linalg.norm(np.diff(curve, axis=0), axis=-1).sum()
    end = curve[-1] / arc
    angle = np.arctan2(0.1, 0.55)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    heading = np.arctan2(2 * 0.5 - 0.1, 0.55) + angle
    assert np.degrees(angle) == pytest.approx(10.3, abs=0.05)
    np.testing.assert_allclose(all_paths(splines(5))[1, -1], [*(rotation @ end), heading], atol=2e-4)


@pytest.mark.parametrize("params", [[0.5, 0.0], [-1.0, 0.0], [0.3, 0.7], [0.0, -1.0]])
def test_a_cubic_curve_ends_at_its_bearing_and_heading(params):
    motions = cubic()
    end = np.asarray(paths_of(motions, jnp.asarray([params])))[0, -1]
    bearing = 0.8 * params[0]
    assert np.arctan2(end[1], end[0]) == pytest.approx(bearing, abs=1e-12)
    assert wrapped(end[2] - 2.0 * bearing) == pytest.approx(1.5 * params[1], abs=1e-12)
