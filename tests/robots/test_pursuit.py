"""Pure pursuit: the geometry of routes, of the circle through a point, and of steered wheels."""

import functools
from math import pi

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.robots import pursuit
from bojax.robots.pursuit import PIECES
from tests.reference import pure_pursuit

RADIUS, NUM_POSES = 0.3, 10


def on_a_circle(angles):
    """Poses of a turn to the left about (0, RADIUS), from the origin."""
    return np.stack([RADIUS * np.sin(angles), RADIUS * (1 - np.cos(angles)), angles], axis=-1)


ANGLES = np.linspace(0.0, 1.0 / RADIUS, NUM_POSES + 1)
PATH = on_a_circle(ANGLES)[1:]
START = np.zeros(3)
route = jax.jit(pursuit.route)
nearest = jax.jit(pursuit.Route.nearest)
at = jax.jit(pursuit.Route.at)


@functools.cache
def circle():
    """The route along `PATH`."""
    return route(jnp.asarray(START), jnp.asarray(PATH))


def test_a_route_passes_all_poses_along_their_headings():
    points = np.asarray(circle().points)
    np.testing.assert_allclose(points[PIECES::PIECES], PATH[:, :2], atol=1e-12)
    inner = np.arange(PIECES, NUM_POSES * PIECES, PIECES)
    along = points[inner + 1] - points[inner - 1]
    np.testing.assert_allclose(np.arctan2(along[:, 1], along[:, 0]), PATH[:-1, 2] % (2 * pi), atol=2e-3)


def test_a_route_of_a_circle_is_the_circle():
    distance = np.linalg.norm(np.asarray(circle().points) - [0.0, RADIUS], axis=1)
    np.testing.assert_allclose(distance, RADIUS, atol=3e-4)
    np.testing.assert_allclose(circle().length, 1.0, atol=1e-3)
    np.testing.assert_allclose(np.diff(circle().arc), 1.0 / (NUM_POSES * PIECES), rtol=0.03)


def test_routes_are_the_cubic_curves_of_the_reference():
    rng = np.random.default_rng(0)
    for _ in range(5):
        start, path = rng.normal(size=3), rng.normal(size=(4, 3))
        found = route(jnp.asarray(start), jnp.asarray(path))
        np.testing.assert_allclose(found.points, pure_pursuit.dense(start, path), atol=1e-12)


def test_poses_that_repeat_make_no_way():
    stopped = np.concatenate([PATH[:4], np.repeat(PATH[3:4], 6, axis=0)])
    found = route(jnp.asarray(START), jnp.asarray(stopped))
    np.testing.assert_allclose(found.arc[4 * PIECES :], found.arc[4 * PIECES], atol=1e-15)
    ahead = found.at(found.length + 0.2)
    heading = PATH[3, 2]
    expected = PATH[3, :2] + 0.2 * np.array([np.cos(heading), np.sin(heading)])
    np.testing.assert_allclose(ahead, expected, atol=1e-12)


def test_a_route_goes_straight_on_after_its_end():
    for beyond in (0.0, 0.1, 0.5):
        expected = PATH[-1, :2] + beyond * np.array([np.cos(PATH[-1, 2]), np.sin(PATH[-1, 2])])
        np.testing.assert_allclose(circle().at(circle().length + beyond), expected, atol=1e-12)


def test_the_nearest_point_lies_ahead_and_within_reach():
    rng = np.random.default_rng(1)
    points, arc = np.asarray(circle().points), np.asarray(circle().arc)
    positions = rng.uniform([-0.4, -0.2], [0.4, 0.8], (300, 2))
    after = rng.integers(0, len(arc), 300)
    nearest_of_each = jax.jit(jax.vmap(circle().nearest, in_axes=(0, 0, None)))
    found = nearest_of_each(jnp.asarray(positions), jnp.asarray(after, jnp.int32), jnp.asarray(0.15))
    for position, first, index in zip(positions, after, found, strict=True):
        allowed = [i for i in range(first, len(arc)) if arc[i] <= arc[first] + 0.15]
        expected = min(allowed, key=lambda i: np.hypot(*(points[i] - position)))
        assert index == expected
    assert np.any(np.asarray(found) == after) and np.any(np.asarray(found) > after)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_route_is_passed_to_its_end_however_short_the_reach(share):
    reach = jnp.asarray(share * np.diff(np.asarray(circle().arc)).min())
    passed = jnp.zeros((), jnp.int32)
    for place in np.linspace(0.0, float(circle().length), 2 * len(circle().arc)):
        passed = nearest(circle(), at(circle(), jnp.asarray(place)), passed, reach)
    assert passed == len(circle().arc) - 1
    assert nearest(circle(), circle().points[-1], passed, reach) == passed


def test_the_curvature_is_that_of_the_circle_through_the_point():
    rng = np.random.default_rng(2)
    curvature = jax.jit(pursuit.curvature)
    for _ in range(20):
        bend, turn = rng.uniform(-8.0, 8.0), rng.uniform(0.05, 1.5)
        x, y, heading = pose = rng.uniform(-2.0, 2.0, 3)
        angle = np.sign(bend) * turn
        local = np.array([np.sin(angle), 1.0 - np.cos(angle)]) / bend
        rotation = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        goal = np.array([x, y]) + rotation @ local
        found = curvature(jnp.asarray(pose), jnp.asarray(goal))
        np.testing.assert_allclose(found, bend, rtol=1e-9)
    straight = pursuit.curvature(jnp.asarray(START), jnp.asarray([0.3, 0.0]))
    assert float(straight) == 0.0


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_a_point_reached_is_no_division_by_zero(dtype):
    pose = jnp.zeros((3,), dtype)
    found = pursuit.curvature(pose, pose[:2])
    assert found.dtype == dtype and float(found) == 0.0


@pytest.mark.parametrize("bend", [-9.0, -1.0, 1e-6, 2.0, 9.0])
def test_the_axes_of_all_wheels_meet(bend):
    wheelbase, half_track = 0.1, 0.04
    angles = pursuit.wheel_angles(*(jnp.asarray(number) for number in (bend, wheelbase, half_track)))
    centre = np.array([0.0, 1.0 / bend])
    for angle, side in zip(np.asarray(angles), (half_track, -half_track), strict=True):
        spoke = centre - [wheelbase, side]
        rolls = np.array([np.cos(angle), np.sin(angle)])
        assert abs(spoke @ rolls) / np.hypot(*spoke) < 1e-12
        assert angle * bend > 0.0
