"""Lawnmowers: they stay inside, cover the area, have the length that lines of their distance need."""

import math

import numpy as np
import pytest
import shapely

from bojax.areas.area import Area
from bojax.areas.shapes import to_shape
from bojax.areas.transfers import Transfers
from bojax.surveys.lawnmower import Ground, cut, lawnmower, lawnmowers_within, length_of
from bojax.surveys.polylines import driven_at, points_along

HOLE = np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]])
SQUARE = Area.rectangle(0.0, 0.0, 10.0, 10.0)
TURN = np.linspace(0.0, 2.0 * math.pi, 60, endpoint=False)
BAY = (5.0 + 0.8 * np.sin(3.0 * TURN))[:, None] * np.stack([np.cos(TURN), np.sin(TURN)], axis=1)
U_SHAPE = np.array(
    [[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [7.0, 8.0], [7.0, 3.0], [3.0, 3.0], [3.0, 8.0], [0.0, 8.0]]
)
AREAS = {
    "square": SQUARE,
    "hole": Area((*SQUARE.outline, HOLE)),
    "zones": SQUARE.without([[HOLE], [HOLE + 1.5]]),
    "bay": Area((BAY, 0.2 * BAY + np.array([1.0, -1.0]))),
    "u-shape": Area((U_SHAPE,)),
}
ANGLES = (0.0, 0.5, 1.2, math.pi / 2)


def is_inside(area: Area, route: np.ndarray) -> bool:
    return bool(shapely.covers(to_shape(area).buffer(1e-6), shapely.LineString(route)))


def apart(area: Area, route: np.ndarray) -> np.ndarray:
    """Distance of the points of a grid from the route."""
    return shapely.distance(shapely.LineString(route), shapely.points(area.grid(0.1)))


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("name", AREAS)
def test_a_lawnmower_stays_inside_and_covers_the_area(name: str, angle: float) -> None:
    area, spacing = AREAS[name], 0.8
    route = lawnmower(area, spacing, angle).route
    assert is_inside(area, route)
    distance = apart(area, route)
    assert np.mean(distance <= spacing / 2 + 1e-6) > 0.985  # corners between two lines are cut
    assert distance.max() < spacing
    # Beside the lines there are the ways between them: along the border, and around holes.
    lines = to_shape(area).area / spacing
    assert 0.95 * lines < length_of(route) < 1.1 * lines + to_shape(area).length


def test_lines_of_a_square_are_as_many_as_needed_and_may_be_inset_by_half_a_spacing() -> None:
    route = lawnmower(SQUARE, 2.0).route
    assert length_of(route) == pytest.approx(5 * 10.0 + 4 * 2.0)
    assert len(route) == 10
    route = lawnmower(SQUARE, 1.0, inset=True).route
    np.testing.assert_allclose([route.min(0), route.max(0)], [[0.5, 0.5], [9.5, 9.5]])
    assert length_of(route) == pytest.approx(10 * 9.0 + 9.0)


@pytest.mark.parametrize("name", ["hole", "u-shape"])
def test_a_route_begins_and_ends_where_it_must(name: str) -> None:
    start, end = np.array([1.0, 7.0]), np.array([9.0, 7.5])
    route = lawnmower(AREAS[name], 1.0, 0.3, start, end).route
    np.testing.assert_array_equal(route[[0, -1]], [start, end])
    assert is_inside(AREAS[name], route)


@pytest.mark.parametrize("budget", [15.0, 40.0, 90.0])
@pytest.mark.parametrize("has_end", [False, True])
@pytest.mark.parametrize("name", ["zones", "u-shape"])
def test_the_budget_is_kept(name: str, has_end: bool, budget: float) -> None:
    ground = Ground.of(AREAS[name])
    start, end = np.array([1.0, 1.0]), np.array([9.0, 7.5]) if has_end else None
    for angle in ANGLES:
        for route, _ in lawnmowers_within(ground, budget, angle, start, end):
            assert length_of(route) <= budget + 1e-9
            assert is_inside(AREAS[name], route)
            np.testing.assert_array_equal(route[0], start)
            if end is not None:
                np.testing.assert_allclose(route[-1], end)


@pytest.mark.parametrize("name", AREAS)
def test_a_route_is_cut_where_the_way_to_the_end_uses_up_the_budget(name: str) -> None:
    area = AREAS[name]
    transfers, route = Transfers(to_shape(area)), lawnmower(area, 1.1, 0.4).route
    driven = driven_at(route)
    rng = np.random.default_rng(0)
    for end in route[rng.choice(len(route), 6)]:

        def total(distance: float, end: np.ndarray = end) -> float:
            return distance + length_of(transfers.path(points_along(route, np.array([distance]))[0], end))

        for share in rng.random(6):
            budget = total(0.0) + share * (total(driven[-1]) - total(0.0))
            low, high = 0.0, driven[-1]
            for _ in range(60):
                middle = (low + high) / 2.0
                low, high = (middle, high) if total(middle) <= budget else (low, middle)
            found = cut(route, budget, end, transfers)
            assert length_of(found) <= budget * (1.0 + 1e-12)
            assert length_of(found) == pytest.approx(budget, rel=1e-8)
            np.testing.assert_array_equal(found[-1], end)
            assert is_inside(area, found)
            # Close to the largest distance from which the way back is as long: it may be as long for a while.
            kept = min(len(found), int(np.sum(driven <= low)))
            np.testing.assert_array_equal(found[: kept - 1], route[: kept - 1])
    np.testing.assert_array_equal(
        cut(route, 2.0 * driven[-1] + 100.0, route[0], transfers)[: len(route)], route
    )


def test_a_budget_is_used_up_and_more_of_it_covers_more() -> None:
    ground = Ground.of(AREAS["hole"])
    reached = [
        min(apart(AREAS["hole"], route).mean() for route, _ in lawnmowers_within(ground, budget))
        for budget in (20, 40, 80)
    ]
    assert reached[0] > reached[1] > reached[2]
    assert max(length_of(route) for route, _ in lawnmowers_within(ground, 40.0)) > 39.0


def test_the_way_around_a_hole_is_the_shortest() -> None:
    path = Ground.of(AREAS["hole"]).transfers.path(np.array([3.0, 5.0]), np.array([7.0, 5.0]))
    assert length_of(path) == pytest.approx(2.0 + 2.0 * math.sqrt(2.0))


def test_of_several_parts_the_one_with_the_start_is_covered() -> None:
    parts = Area((*SQUARE.outline, *Area.rectangle(20.0, 0.0, 25.0, 5.0).outline))
    assert Ground.of(parts).size == pytest.approx(100.0)
    assert Ground.of(parts, np.array([21.0, 1.0])).size == pytest.approx(25.0)
    with pytest.raises(ValueError, match="no path in the area joins"):
        Ground.of(parts).transfers.path(np.array([1.0, 1.0]), np.array([21.0, 1.0]))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: lawnmower(SQUARE, 1e-4),
            "spacing: got 0.0001 m, 100,000 lines; allowed: at least 0.001 m here",
        ),
        (lambda: lawnmower(AREAS["hole"], 1.0, start=np.array([5.0, 5.0])), r"\(5, 5\) is not in the area"),
        (lambda: lawnmowers_within(Ground.of(SQUARE), -1.0), "budget: got -1 m; allowed: > 0 m"),
        (
            lambda: lawnmowers_within(
                Ground.of(SQUARE), 5.0, 0.0, np.array([1.0, 1.0]), np.array([9.0, 1.0])
            ),
            "budget: got 5 m, but the shortest way from the start to the end is 8 m long",
        ),
        (lambda: Ground.of(SQUARE.without([SQUARE.outline])), "the area is empty"),
    ],
)
def test_what_cannot_be_driven_is_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("name", AREAS)
def test_inset_lines_stay_inside_and_are_shorter(name: str) -> None:
    area, spacing = AREAS[name], 0.8
    route = lawnmower(area, spacing, inset=True).route
    assert is_inside(area, route)
    assert length_of(route) < length_of(lawnmower(area, spacing).route)
    assert np.mean(apart(area, route) <= spacing / 2 + 1e-6) > 0.96
