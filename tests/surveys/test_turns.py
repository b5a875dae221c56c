"""Routes with a turning radius: at each corner, an arc of it touches both legs, and arcs do not overlap."""

import contextlib
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from bojax.areas.area import Area
from bojax.areas.shapes import to_shape
from bojax.surveys.descent import Limits
from bojax.surveys.lawnmower import DIRECTIONS, Ground, TurnsTooTight, lawnmower, lawnmowers_within
from bojax.surveys.lawnmower import _order_apart as order_apart
from bojax.surveys.mission import Mission
from bojax.surveys.polylines import length_of, points_along, rest_of
from bojax.surveys.route import RouteOptions
from bojax.surveys.turns import drivable, least_radius, turned
from tests.surveys.test_lawnmower import AREAS, SQUARE, apart, is_inside
from tests.surveys.test_route import planned


def can_be_driven(route: np.ndarray, radius: float) -> bool:
    """Whether circles of a radius touch both legs of each corner, in the order of the corners on each leg."""
    legs = [shapely.LineString(pair) for pair in zip(route[:-1], route[1:], strict=True)]
    touching = [[0.0] for _ in legs]
    for index in range(1, len(legs)):
        (a, b), (_, c) = route[index - 1 : index + 1], route[index : index + 2]
        side = np.sign((b - a)[0] * (c - b)[1] - (b - a)[1] * (c - b)[0])
        # The centre is as far to the same side of both legs: an intersection of two lines.
        normals = [side * np.array([-v[1], v[0]]) / np.hypot(*v) for v in (b - a, c - b)]
        if np.dot(b - a, c - b) < 0.0 and abs(np.linalg.det(normals)) < 1e-9:
            return False  # a turn on the spot
        if side == 0.0 or np.linalg.det(normals) == 0.0:
            continue
        centre = b + np.linalg.solve(normals, [radius, radius])
        for leg in (index - 1, index):
            if shapely.distance(shapely.Point(centre), legs[leg]) > radius * (1.0 + 1e-6):
                return False
            touching[leg].append(shapely.line_locate_point(legs[leg], shapely.Point(centre)))
    return all(np.all(np.diff(places) >= -1e-6 * radius) for places in touching)


@pytest.mark.parametrize("number", [4, 6, 30])
def test_the_radius_of_a_polygon_is_that_of_the_circle_in_it(number):
    angles = 2.0 * np.pi * np.arange(number + 1) / number
    corners = 5.0 / np.cos(np.pi / number) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    assert least_radius(corners) == pytest.approx(5.0)
    assert can_be_driven(corners, 4.999) and not can_be_driven(corners, 5.001)


@pytest.mark.parametrize("seed", range(10))
def test_a_route_is_rounded_near_itself_and_gets_no_longer(seed):
    given = np.random.default_rng(seed).uniform(0.0, 100.0, (8, 2))
    route = drivable(given, 2.0)
    assert route is not None
    assert can_be_driven(given, 2.0) == (least_radius(given) >= 2.0)
    assert can_be_driven(route, 2.0) and least_radius(route) >= 2.0 * (1.0 - 1e-9)
    assert length_of(route) <= length_of(given)
    np.testing.assert_array_equal(route[[0, -1]], given[[0, -1]])
    turns = np.abs(np.diff(np.unwrap(np.arctan2(*np.diff(route, axis=0).T[::-1]))))
    assert np.degrees(turns.max()) < 15.001


def test_a_turn_on_the_spot_and_repeated_points_are_repaired():
    there_and_back = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 0.0], [30.0, 0.0], [1.0, 0.0], [1.0, 40.0]])
    route = drivable(there_and_back, 3.0)
    assert route is not None and can_be_driven(route, 3.0)
    assert drivable(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 1.0], [0.0, 1.0]]), 6.0) is None
    assert drivable(there_and_back, 0.0) is there_and_back


def test_turns_on_the_spot_in_any_direction_have_no_radius():
    angles = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 200)
    for angle, length in zip(angles, np.linspace(0.1, 100.0, 200), strict=True):
        leg = length * np.array([np.cos(angle), np.sin(angle)])
        assert least_radius(np.stack([-leg, leg, 0.3 * leg])) < 1e-3 * length
        assert least_radius(np.stack([-leg, leg])) == np.inf
    with pytest.raises(ValueError, match="turning radius: got -1"):
        drivable(np.zeros((3, 2)), -1.0)


@pytest.mark.parametrize("least", [1, 2, 3, 7])
def test_lines_in_a_row_are_apart(least):
    for number in range(1, 60):
        order = order_apart(number, least)
        assert sorted(order) == list(range(number))
        if number > 2 * least:
            assert np.abs(np.diff(order)).min(initial=least) >= least


@pytest.mark.parametrize("name", ["square", "hole", "bay"])
def test_lawnmowers_turn_as_widely_as_they_must(name):
    """In most directions: lines that end close beside a hole may leave no room for a turn."""
    area, ends = (
        AREAS[name],
        (np.array([-3.0, 1.0]) if name == "bay" else np.array([1.0, 1.5]), np.array([3.0, 1.5])),
    )
    ground, found = Ground.of(area, turning_radius=0.3), []
    for angle in np.arange(DIRECTIONS) * np.pi / DIRECTIONS:
        with contextlib.suppress(TurnsTooTight):
            route = lawnmower(ground, 1.0, angle).route
            assert np.mean(apart(area, route) < 1.0) > 0.95
            found.append(route)
        for route, _ in lawnmowers_within(ground, 60.0, angle, *ends):
            assert length_of(route) <= 60.0 + 1e-9
            np.testing.assert_allclose(route[[0, -1]], ends)
            found.append(route)
    assert len(found) >= 2 * DIRECTIONS
    for route in found:
        assert can_be_driven(route, 0.3) and is_inside(area, route)


def test_the_share_of_waypoints_that_turns_leave_out_is_told():
    evenly = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    close = np.insert(evenly, 2, [[10.0, 0.1]], axis=0)  # a fifth waypoint beside another
    for given, left_out in ((evenly, 0.0), (np.repeat(evenly, 2, axis=0), 0.0), (close, 0.2)):
        found = turned(given, 2.0)
        assert found is not None and found.left_out == pytest.approx(left_out)


def test_lines_closer_than_a_turn_are_driven_in_another_order():
    route = lawnmower(Ground.of(SQUARE, turning_radius=0.6), 0.4).route
    assert can_be_driven(route, 0.6) and is_inside(SQUARE, route)
    inner = Area.rectangle(0.6, 0.0, 9.4, 10.0)  # lines end a radius before the border
    assert np.mean(apart(inner, route) < 0.4) > 0.99
    assert length_of(route) < 1.3 * length_of(lawnmower(SQUARE, 0.4).route)


def test_an_area_without_room_for_the_turns_is_one_line():
    ground = Ground.of(Area.rectangle(0.0, 0.0, 10.0, 4.0), turning_radius=2.5)
    with pytest.raises(
        TurnsTooTight, match=r"^turning radius: got 2.5 m, .*; allowed: a smaller one, or lines"
    ):
        lawnmower(ground, 1.0)


def test_an_optimised_route_turns_as_widely_as_it_must():
    area = AREAS["hole"]
    options = RouteOptions(waypoints=32, restarts=2, steps=40, models=2, turning_radius=0.5)
    ends = [1.0, 1.0], [9.0, 9.0]
    route = planned(area, 40.0, *ends, options=options)
    assert can_be_driven(route.waypoints, 0.5)
    assert shapely.covers(to_shape(area).buffer(1e-6), shapely.LineString(route.waypoints))
    assert 36.0 < route.length <= 40.0 + 1e-6
    np.testing.assert_allclose(route.waypoints[[0, -1]], ends)
    usual, wide = (dataclasses.replace(options, turning_radius=radius) for radius in (0.0, 9.0))
    assert not can_be_driven(planned(area, 40.0, *ends, options=usual).waypoints, 0.5)
    with pytest.raises(ValueError, match=r"with turns of 9 m stays in the area; allowed: a smaller turning"):
        planned(area, 40.0, *ends, options=wide)


def test_the_plans_of_a_mission_turn_as_widely_as_they_must(monkeypatch):
    options = RouteOptions(waypoints=32, restarts=2, steps=10, models=1, turning_radius=0.5)
    mission = Mission(SQUARE, 40.0, [1.0, 1.0], spacing=0.5, options=options)
    for distance in (8.0, 7.0):
        way = np.concatenate([mission.position[None], mission.plan()])
        assert can_be_driven(way, 0.5) and is_inside(SQUARE, way)
        points = points_along(way, np.arange(0.5, distance, 0.5))
        mission.observe(points, np.sin(points[:, 0]))

    def too_tight(*given, **named):
        raise ValueError("none of the routes")

    # From where the robot is, there may be no route with such turns but what is left of its plan.
    monkeypatch.setattr("bojax.surveys.mission.plan_routes", too_tight)
    np.testing.assert_allclose(mission.plan(), rest_of(way, mission.position)[1:])
    assert mission.counts["tight_turns"] == 1
    with pytest.raises(ValueError, match="none of the routes"):
        Mission(SQUARE, 40.0, [1.0, 1.0], spacing=0.5, options=options).plan()


def test_a_first_guess_with_a_repeated_waypoint_is_optimised():
    guess = np.array([[1.0, 1.0], [5.0, 9.0], [5.0, 9.0], [5.0, 9.0], [9.0, 1.0]])
    for radius in (None, 0.3):
        limits = Limits(
            None, jnp.asarray(0.1), None if radius is None else jnp.asarray(radius), jnp.asarray(0.0)
        )
        gradient = jax.grad(lambda route, limits=limits: limits._penalty_of_one(route, jnp.asarray(1.0), 20)
                            + limits.saved_by_arcs(route))  # fmt: skip
        assert jnp.isfinite(jax.jit(gradient)(jnp.asarray(guess))).all()
