"""The league maps what a route measures, and scores maps and sets as a plain computation does."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from scipy.optimize import minimize

from bojax.areas.shapes import to_shape
from bojax.surveys.information import PointErrors
from bojax.surveys.league import routes
from bojax.surveys.league.cells import COVERING, GOALS, LENGTHS, Cell, cells_of
from bojax.surveys.league.fields import (
    LENGTHSCALE,
    MODEL,
    NOISE_VARIANCE,
    SIDE,
    SQUARE,
    VARIANCE,
    Field,
    league,
)
from bojax.surveys.league.rivals import corner_route
from bojax.surveys.league.routes import (
    GRID,
    SPACING,
    adaptive_route,
    map_routes,
    noises,
    peers,
    start_of,
    surveyed,
)
from bojax.surveys.league.scores import scores_of, threshold_of
from bojax.surveys.mission import Mission
from bojax.surveys.polylines import length_of, points_along
from bojax.surveys.route import RouteOptions, spread_points
from tests.reference.gaussian_process import GP, LinearMean, Scaled, Stationary, matern52

FIELD = Field("waves", SQUARE, lambda points: np.sin(points[:, 0]) + 0.1 * points[:, 1])
PLACES = ("square", "coast", "new-guinea", "course")
ROUTE = np.array([[1.0, 1.0], [9.0, 1.0], [9.0, 8.0]])


def posterior(x, y, lengthscale=LENGTHSCALE, variance=VARIANCE, noise=NOISE_VARIANCE):
    return GP(Scaled(Stationary(matern52, None, lengthscale), variance), LinearMean(), noise, x, y)


def learned_mean(x, y, grid):
    """The mean at the highest posterior density of the logarithms, whose prior deviations are 1, by SciPy."""
    medians = np.log([LENGTHSCALE, VARIANCE, NOISE_VARIANCE])

    def loss(logs):
        gp = posterior(x, y, *np.exp(logs))
        evidence = 0.5 * y @ gp.weights + np.log(np.diag(gp.cholesky)).sum()
        return evidence + 0.5 * np.sum((logs - medians) ** 2)

    starts = [medians, medians + [0.7, 0.7, 0.0], medians - [0.7, 0.0, 0.7]]
    found = min((minimize(loss, start) for start in starts), key=lambda each: each.fun)
    return posterior(x, y, *np.exp(found.x)).predict(grid)[0]


def test_scores_are_those_of_a_plain_gaussian_process(usual_jax):
    with jax.enable_x64(True):
        found = scores_of(FIELD, ROUTE, 15.0, 3)
    x = points_along(ROUTE, SPACING * np.arange(1, 76))
    y = FIELD.value(x) + noises(15.0, 3)
    grid = SQUARE.grid(GRID)
    truth = FIELD.value(grid)
    mean, covariance = posterior(x, y).predict(grid)
    threshold = np.quantile(truth, 0.8)
    above, put_above = truth > threshold, mean > threshold
    assert threshold_of(FIELD) == pytest.approx(threshold)
    assert found["rmse"] == pytest.approx(np.sqrt(np.mean((truth - mean) ** 2)), rel=1e-6)
    learned = learned_mean(x, y, grid)
    assert found["rmse_learned"] == pytest.approx(np.sqrt(np.mean((truth - learned) ** 2)), rel=1e-3)
    assert abs(found["rmse_learned"] - found["rmse"]) > 1e-2
    assert found["deviation"] == pytest.approx(np.mean(np.sqrt(np.diag(covariance))), rel=1e-6)
    assert found["regret"] == pytest.approx(truth.max() - truth[np.argmax(mean)], abs=1e-9)
    assert found["missed"] == np.mean(above != put_above)
    hits = np.sum(above & put_above)
    assert found["f1"] == pytest.approx(hits / (hits + 0.5 * np.sum(above != put_above)))


def test_an_adaptive_route_uses_the_length_and_goes_where_it_measures(monkeypatch):
    options = RouteOptions(waypoints=8, restarts=2, steps=2, models=1)
    monkeypatch.setattr(routes, "Mission", lambda *given, **named: Mission(*given, options=options, **named))
    seen = []
    monkeypatch.setattr(Mission, "observe", _noting(seen, Mission.observe))
    route = adaptive_route(FIELD, 11.0, 2, "hotspots")
    assert length_of(route) == pytest.approx(11.0, rel=1e-6)
    np.testing.assert_allclose(route[0], start_of(SQUARE, 2))
    measured = np.concatenate([points for points, _ in seen])
    np.testing.assert_allclose(measured, points_along(route, SPACING * np.arange(1, 56)), atol=1e-6)
    values = np.concatenate([values for _, values in seen])
    np.testing.assert_allclose(values, FIELD.value(measured) + noises(11.0, 2), atol=1e-6)


def _noting(seen, observe):
    def noted(mission, points, values, *rest):
        seen.append((np.asarray(points), np.asarray(values)))
        return observe(mission, points, values, *rest)

    return noted


def test_stored_routes_keep_their_length_and_stay_in_their_area():
    lengths = (*LENGTHS, COVERING)
    assert peers().keys() - {"about", "starts"} == {
        f"sgptools-{place}-{length}" for place in PLACES for length in lengths
    }
    for field in {field.place: field for field in league()}.values():
        part = surveyed(field.area)
        inside = to_shape(part).buffer(1e-3)
        for length in lengths:
            for index, path in enumerate(peers().get(f"sgptools-{field.place}-{length}", ())):
                route = np.array(path)
                np.testing.assert_allclose(route[0], start_of(part, index), atol=1e-3)
                assert length_of(route) <= length * 1.003
                assert shapely.covers(inside, shapely.LineString(route))


def test_a_stored_route_is_among_those_of_its_place(monkeypatch):
    course = Field("course", SQUARE, FIELD.value)
    monkeypatch.setattr(Field, "place", property(lambda field: field.name))
    planned = SimpleNamespace(routes=[ROUTE])
    survey = SimpleNamespace(chosen=planned, lawnmower=planned)
    monkeypatch.setattr(routes, "plan_survey", lambda *given: survey)
    monkeypatch.setattr(routes, "myopic_route", lambda *given: ROUTE)
    found, _ = map_routes(course, 20, 3)
    np.testing.assert_array_equal(found["SGP-Tools"], peers()["sgptools-course-20"][3])
    assert "lawnmower from a corner" not in found
    assert "lawnmower from a corner" in map_routes(Field("square", SQUARE, FIELD.value), 20, 3)[0]


def test_lines_from_a_corner_use_the_length_and_are_those_of_the_least_expected_error(usual_jax):
    start = np.array([2.593, 3.584])
    with jax.enable_x64(True):
        errors = PointErrors.of(MODEL.belief(), jnp.asarray(spread_points(SQUARE, 100)))
        route = corner_route(SIDE, errors, 40.0, start, SPACING)
        mirrored = corner_route(SIDE, errors, 40.0, SIDE - start, SPACING)
    # Four lines, as given with the first measurements of such routes, to a hundredth.
    x, low, high = [1.27, 3.757, 6.243, 8.73], 1.27, 8.73
    lines = [(x[0], low), (x[0], high), (x[1], high), (x[1], low), (x[2], low), (x[2], high), (x[3], high)]
    np.testing.assert_allclose(route, [start, *lines, (x[3], low)], atol=0.006)
    assert length_of(route) == pytest.approx(40.0)
    assert length_of(mirrored) == pytest.approx(40.0)
    np.testing.assert_allclose(mirrored[1], SIDE - route[1], atol=1e-6)


def test_places_share_their_routes():
    other = Field("island", SQUARE.without([(np.array([[4.0, 4.0], [5.0, 4.0], [4.0, 5.0]]),)]), FIELD.value)
    twin = Field("twin", SQUARE, FIELD.value)
    cells = list(cells_of([FIELD, other, twin], 2))
    number = len(LENGTHS) * (2 + 3 * (len(GOALS) - 1)) + 2  # a length that covers is for maps alone
    assert len({cell.name for cell in cells}) == len(cells) == 2 * number
    maps = [cell for cell in cells if cell.goal == "map" and cell.place == "square"]
    assert [[field.name for field in cell.fields] for cell in maps] == [["waves", "twin"]] * 6
    assert all(isinstance(cell, Cell) and cell.start == 0 for cell in cells[: len(cells) // 2])
