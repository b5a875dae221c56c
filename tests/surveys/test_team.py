"""Several robots: parts of equal size, a part for the nearest robot, and the distance between robots."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from bojax.areas.area import Area
from bojax.surveys.information import PointErrors, left_by, samples_along, samples_of_all
from bojax.surveys.lawnmower import Ground
from bojax.surveys.polylines import length_of
from bojax.surveys.route import RouteOptions, plan_routes, stays_inside
from bojax.surveys.team import least_distance, parts_of, split_points, team_lawnmowers
from tests.surveys.test_route import belief

HOLE = np.array([[2.0, 2.0], [4.0, 2.0], [4.0, 4.0], [2.0, 4.0]])
POND = Area.rectangle(0.0, 0.0, 6.0, 6.0).without([(HOLE,)])
GROUND = Ground.of(POND)
QUICK = RouteOptions(waypoints=12, restarts=3, steps=10, models=2)


@pytest.mark.parametrize("number", [1, 2, 3, 4])
@pytest.mark.parametrize("angle", [0.0, 0.7, np.pi / 2])
def test_parts_have_equal_sizes_and_are_the_whole(number, angle):
    parts = parts_of(GROUND, number, angle)
    np.testing.assert_allclose([part.size for part in parts], GROUND.size / number, rtol=1e-6)
    whole = shapely.union_all([part.shape for part in parts])
    assert shapely.symmetric_difference(whole, GROUND.shape).area < 1e-6


@pytest.mark.parametrize("number", [2, 3, 4])
def test_lawnmowers_of_a_team_keep_their_budgets_and_stay_inside(number):
    starts = [np.array([0.2, 0.2])] * number
    for routes in team_lawnmowers(GROUND, number, 0.3, starts, starts, 25.0, 0.0):
        for route, _ in routes:
            assert length_of(route) <= 25.0 + 1e-6
            assert stays_inside(route, POND)
            np.testing.assert_allclose(route[[0, -1]], [starts[0], starts[0]])


def test_each_robot_takes_the_part_next_to_its_start():
    points = POND.grid(0.25)
    starts = [np.array([3.0, 6.0]), np.array([3.0, 0.0])]
    upper, lower = split_points(points, 2, 0.0, starts, [None, None])
    assert upper[:, 1].min() > lower[:, 1].max()
    assert abs(len(upper) - len(lower)) <= 1


def test_the_least_distance_is_that_at_equal_times():
    first = np.array([[0.0, 0.0], [10.0, 0.0]])
    # The routes cross at (5, 0), where the second robot is 1 m later.
    second = np.array([[5.0, -6.0], [5.0, 4.0]])
    times = np.linspace(0.0, 10.0, 10001)
    expected = np.hypot(times - 5.0, 6.0 - times).min()
    assert least_distance([first, second]) == pytest.approx(expected, abs=1e-3)
    assert least_distance([first]) == np.inf


def test_samples_of_a_team_are_those_of_its_robots():
    routes = jnp.asarray([[[0.0, 0.0], [4.0, 0.0]], [[0.0, 1.0], [2.0, 1.0]]])
    samples, is_taken = jax.jit(lambda: samples_of_all(routes, 1.0, 4))()
    for robot in (0, 1):
        alone, taken = jax.jit(lambda robot=robot: samples_along(routes[robot], 1.0, 4))()
        np.testing.assert_array_equal(samples[robot::2], alone)
        np.testing.assert_array_equal(is_taken[robot::2], taken)
    np.testing.assert_array_equal(is_taken[1::2], [True, True, False, False])


def test_two_robots_learn_more_than_one_and_stay_apart():
    starts = [[0.5, 0.5], [5.5, 0.5]]
    given = {"spacing": 0.3, "options": QUICK}
    found = plan_routes(belief(), POND, 10.0, starts, [None, None], separation=0.5, **given)
    (alone,) = plan_routes(belief(), POND, 10.0, starts[:1], [None], **given)
    assert found[0].error == found[1].error < 0.9 * alone.error
    routes = [each.waypoints for each in found]
    assert least_distance(routes, 0.5) >= 0.5
    for route, start in zip(routes, starts, strict=True):
        np.testing.assert_allclose(route[0], start)
        assert length_of(route) <= 10.0 * (1.0 + 1e-9) and stays_inside(route, POND)
    # The error of both routes is not that of the first one alone.
    grid, samples = jnp.asarray(POND.grid(0.4)), jax.jit(lambda route: samples_along(route, 0.3, 33))
    before = jax.jit(lambda: PointErrors.of(belief(), grid))()
    single = [left_by(before, *samples(jnp.asarray(each)))[0][-1] for each in routes]
    assert min(single) > 1.2 * found[0].error
