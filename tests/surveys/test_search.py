"""The search finds routes of small loss that keep the budget, the ends and the area."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from bojax.areas.area import Area
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.surveys.goals import Goal
from bojax.surveys.lawnmower import Ground
from bojax.surveys.polylines import length_of, points_along
from bojax.surveys.route import stays_inside
from bojax.surveys.search import NUM_SAMPLES, THINNING, Search
from tests.reference.gaussian_process import GP, LinearMean, Stationary, matern52

SQUARE = Area.rectangle(0.0, 0.0, 10.0, 10.0)
PEAK = np.array([8.0, 3.0])
START = np.array([1.0, 8.0])
NOISE = 0.01


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def belief(points, values):
    kernel = Scaled(Matern52(jnp.asarray(1.5)), jnp.asarray(1.0))
    return GaussianProcess.fit(kernel, jnp.asarray(NOISE), jnp.asarray(points), jnp.asarray(values))


SEEN = SQUARE.grid(2.5)
VALUES = 2.0 * np.exp(-0.1 * np.sum((SEEN - PEAK) ** 2, axis=1))


def search(goal, area=SQUARE, budget=12.0, end=None, seed=0):
    ways = Ground.of(area, START).transfers
    random = np.random.default_rng(seed)
    return Search(belief(SEEN, VALUES), area, budget, START, end, goal, spacing=0.2, ways=ways, random=random)


def test_a_route_for_hot_spots_leads_to_the_highest_place():
    route = search(Goal("hotspots")).route().waypoints
    driven = points_along(route, np.linspace(0.0, 12.0, 200))
    assert np.linalg.norm(driven - PEAK, axis=1).min() < 0.75
    assert length_of(route) == pytest.approx(12.0)


def test_the_loss_of_a_route_is_that_of_a_plain_gaussian_process():
    goal = Goal("threshold", threshold=1.0)
    found = search(goal)
    route = found.route()
    points = found._points
    samples = points_along(route.waypoints, 12.0 / NUM_SAMPLES * np.arange(1, NUM_SAMPLES + 1))
    samples = points[cdist(samples, points).argmin(axis=1)]
    counted = points[::THINNING]
    kernel = Stationary(matern52, None, 1.5)
    mean, before = GP(kernel, LinearMean(), NOISE, SEEN, VALUES).predict(counted)
    noise = np.append(np.full(len(SEEN), NOISE), np.full(NUM_SAMPLES, NOISE * 0.2 / (12.0 / NUM_SAMPLES)))
    x = np.concatenate([SEEN, samples])
    _, after = GP(kernel, LinearMean(), noise, x, np.zeros(len(x))).predict(counted)
    before, after = np.diag(before), np.diag(after)
    assert route.error == pytest.approx(goal.loss(mean, before, before - after), rel=1e-6)
    assert route.error == min(route.candidates.values())


def test_an_earlier_plan_is_never_replaced_by_a_worse_one():
    goal = Goal("hotspots")
    first = search(goal, seed=1).route()
    second = search(goal, seed=2).route(first.waypoints)
    assert second.error <= first.error * (1.0 - 1e-9) + 1e-12 or second.error == pytest.approx(first.error)


def test_walls_budget_and_end_are_kept():
    wall = np.array([[4.5, 1.0], [5.5, 1.0], [5.5, 10.0], [4.5, 10.0]])
    area, end = SQUARE.without([(wall,)]), np.array([1.0, 1.0])
    route = search(Goal("hotspots"), area, 30.0, end).route().waypoints
    assert stays_inside(route, area)
    assert length_of(route) <= 30.0 * (1.0 + 1e-9)
    np.testing.assert_allclose(route[[0, -1]], [START, end], atol=1e-6)
    assert route[:, 0].max() > 6.0  # beyond the wall
