"""The league maps what a route measures, and scores maps and sets as a plain computation does."""

import jax
import numpy as np
import pytest
from scipy.spatial.distance import cdist

shapely = pytest.importorskip("shapely")

from bojax.surveys.league import routes  # noqa: E402
from bojax.surveys.league.cells import GOALS, LENGTHS, Cell, cells_of  # noqa: E402
from bojax.surveys.league.fields import (  # noqa: E402
    LENGTHSCALE,
    NOISE_VARIANCE,
    SQUARE,
    VARIANCE,
    Field,
)
from bojax.surveys.league.routes import GRID, SPACING, adaptive_route, noises, peers, start_of  # noqa: E402
from bojax.surveys.league.scores import scores_of, threshold_of  # noqa: E402
from bojax.surveys.mission import Mission  # noqa: E402
from bojax.surveys.polylines import length_of, points_along  # noqa: E402
from bojax.surveys.route import RouteOptions  # noqa: E402

FIELD = Field("waves", SQUARE, lambda points: np.sin(points[:, 0]) + 0.1 * points[:, 1])
ROUTE = np.array([[1.0, 1.0], [9.0, 1.0], [9.0, 8.0]])


def covariance(first, second):
    scaled = np.sqrt(5.0) * cdist(first, second) / LENGTHSCALE
    return VARIANCE * (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)


def test_scores_are_those_of_a_plain_gaussian_process(usual_jax):
    with jax.enable_x64(True):
        found = scores_of(FIELD, ROUTE, 15.0, 3)
    x = points_along(ROUTE, SPACING * np.arange(1, 76))
    y = FIELD.value(x) + noises(15.0, 3)
    grid = SQUARE.grid(GRID)
    truth = FIELD.value(grid)
    gram, cross = covariance(x, x) + NOISE_VARIANCE * np.eye(75), covariance(grid, x)
    mean = cross @ np.linalg.solve(gram, y)
    variance = VARIANCE - np.sum(cross * np.linalg.solve(gram, cross.T).T, axis=1)
    threshold = np.quantile(truth, 0.8)
    above, put_above = truth > threshold, mean > threshold
    assert threshold_of(FIELD) == pytest.approx(threshold)
    assert found["rmse"] == pytest.approx(np.sqrt(np.mean((truth - mean) ** 2)), rel=1e-6)
    assert found["deviation"] == pytest.approx(np.mean(np.sqrt(variance)), rel=1e-6)
    assert found["regret"] == pytest.approx(truth.max() - truth[np.argmax(mean)], abs=1e-9)
    assert found["missed"] == np.mean(above != put_above)
    hits = np.sum(above & put_above)
    assert found["f1"] == pytest.approx(hits / (hits + 0.5 * np.sum(above != put_above)))


def test_a_shorter_route_measures_less(usual_jax):
    with jax.enable_x64(True):
        assert scores_of(FIELD, ROUTE[:2], 15.0, 0)["rmse"] > scores_of(FIELD, ROUTE, 15.0, 0)["rmse"]


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


def test_stored_routes_keep_their_length():
    for length in LENGTHS:
        for key in ("sgptools", "lawnmower"):
            for path, start in zip(peers()[f"{key}-{length}"], peers()["starts"], strict=True):
                np.testing.assert_allclose(path[0], start[:2], atol=1e-3)
                assert length_of(np.array(path)) <= length * 1.01


def test_places_share_their_routes():
    other = Field("island", SQUARE.without([(np.array([[4.0, 4.0], [5.0, 4.0], [4.0, 5.0]]),)]), FIELD.value)
    twin = Field("twin", SQUARE, FIELD.value)
    cells = list(cells_of([FIELD, other, twin], 2))
    assert len({cell.name for cell in cells}) == len(cells) == 2 * len(LENGTHS) * (2 + 3 * (len(GOALS) - 1))
    maps = [cell for cell in cells if cell.goal == "map" and cell.place == "square"]
    assert [[field.name for field in cell.fields] for cell in maps] == [["waves", "twin"]] * 4
    assert all(isinstance(cell, Cell) and cell.start == 0 for cell in cells[: len(cells) // 2])
