"""Routes keep their budget, their ends and the area, and are no worse than the guesses given."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.areas.area import Area
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.surveys.descent import Ends, within_budget
from bojax.surveys.guesses import parallel_lines
from bojax.surveys.information import PointErrors, left_by, samples_along
from bojax.surveys.polylines import length_of, with_waypoints
from bojax.surveys.route import RouteOptions, plan_routes, stays_inside
from tests.compiling import COMPILATION, events_of_jax

QUICK = RouteOptions(waypoints=16, restarts=5, steps=15, models=2)
SQUARE = Area.rectangle(0.0, 0.0, 6.0, 6.0)
HOLE = np.array([[2.0, 2.0], [4.0, 2.0], [4.0, 4.0], [2.0, 4.0]])
WITH_HOLE = SQUARE.without([(HOLE,)])
LAWNMOWER = np.array([[0.5, 0.5], [0.5, 5.5], [3.0, 5.5], [3.0, 0.5], [5.5, 0.5]])  # 15 m


def planned(area, budget, start=None, end=None, first_guesses=None, **given):
    """The route of one robot, whose first guesses are single routes."""
    guesses = {name: [guess] for name, guess in (first_guesses or {}).items()}
    given = {"spacing": 0.3, "options": QUICK} | given
    (route,) = plan_routes(belief(), area, budget, [start], [end], guesses, **given)
    return route


def belief():
    kernel = Scaled(Matern52(jnp.asarray(1.0)), jnp.asarray(1.0))
    return GaussianProcess.prior(kernel, 0.01, 0, 2)


@pytest.mark.parametrize("start", [None, [1.0, 1.0]])
@pytest.mark.parametrize("end", [None, [2.0, 5.0]])
@pytest.mark.parametrize("budget", [4.2, 9.0, 500.0])
def test_a_route_is_drawn_in_to_its_budget_between_its_ends(start, end, budget):
    points = np.random.default_rng(1).uniform(0.0, 6.0, (12, 2))
    ends = Ends(*(None if at is None else jnp.asarray(at) for at in (start, end)))
    route = np.asarray(within_budget(jnp.asarray(points), ends, jnp.asarray(budget)))
    assert length_of(route) <= budget
    assert length_of(route) > 0.5 * min(budget, length_of(points))
    if start is not None:
        np.testing.assert_allclose(route[0], start)
    if end is not None:
        np.testing.assert_allclose(route[-1], end)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"steps": 0}, "options: got 0 steps; allowed: an integer >= 1"),
        ({"waypoints": 1}, "options: got 1 waypoints; allowed: an integer >= 2"),
        ({"models": 2.5}, "options: got 2.5 models; allowed: an integer >= 1"),
    ],
)
def test_options_that_cannot_be_used_are_refused(option, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        RouteOptions(**option)


def test_more_waypoints_do_not_change_a_polyline():
    longer = with_waypoints(LAWNMOWER, 20)
    assert longer.shape == (20, 2)
    assert length_of(longer) == pytest.approx(15.0)
    assert all(np.any(np.all(np.isclose(longer, corner), axis=1)) for corner in LAWNMOWER)


def test_parallel_lines_keep_the_budget_and_use_it():
    lines = parallel_lines(SQUARE.grid(0.5), 0.3, 30.0, np.array([1.0, 1.0]), None)
    assert 20.0 < length_of(lines) <= 30.0


def test_an_optimised_route_expects_a_smaller_error_than_the_lawnmower():
    route = planned(SQUARE, 15.0, LAWNMOWER[0], first_guesses={"lawnmower": LAWNMOWER})
    before = jax.jit(lambda: PointErrors.of(belief(), jnp.asarray(SQUARE.grid(0.3))))()
    samples = jax.jit(lambda way: samples_along(way, 0.3, 50))
    ways = [jnp.asarray(with_waypoints(way, 16)) for way in (route.waypoints, LAWNMOWER)]
    errors = [left_by(before, *samples(way))[0][-1] for way in ways]
    assert "lawnmower" in route.candidates
    assert route.error == min(route.candidates.values())
    assert errors[0] < 0.97 * errors[1]
    assert route.length <= 15.0 * (1.0 + 1e-9)


def test_a_better_first_guess_is_chosen_as_it_is():
    no_steps = RouteOptions(waypoints=16, restarts=1, steps=1, models=2)
    bad = np.array([[0.5, 0.5], [0.6, 0.6]])
    guesses = {"bad": bad, "lawnmower": LAWNMOWER}
    route = planned(SQUARE, 15.0, first_guesses=guesses, options=no_steps)
    assert route.chosen in ("lawnmower", "optimised from lawnmower")
    assert length_of(route.waypoints) == pytest.approx(15.0)


def test_a_route_goes_round_a_hole_and_reaches_its_end():
    route = planned(WITH_HOLE, 16.0, [0.5, 3.0], [5.5, 3.0])
    np.testing.assert_allclose(route.waypoints[[0, -1]], [[0.5, 3.0], [5.5, 3.0]])
    assert stays_inside(route.waypoints, WITH_HOLE)
    assert not stays_inside(np.array([[0.5, 3.0], [5.5, 3.0]]), WITH_HOLE)
    assert route.length <= 16.0 * (1.0 + 1e-9)


def test_another_budget_compiles_nothing():
    route = planned(SQUARE, 15.0, [1.0, 1.0])
    lines = {name for name in route.candidates if "lines" in name}  # named as lawnmowers are
    assert lines and lines <= {f"optimised from lines at {angle}°" for angle in (0, 45, 90, 135)}
    with events_of_jax() as events:
        planned(SQUARE, 11.0, [3.0, 2.0], key=jax.random.key(1))
    assert COMPILATION not in events
