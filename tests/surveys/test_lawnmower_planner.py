"""The planner `lawnmower`: its route covers an area with a hole within the budget, and makes a better map."""

import json
import math

import equinox as eqx
import jax
import numpy as np
import pytest
import shapely

from bojax.areas.outlined import OutlinedArea
from bojax.experiments.planning import PlanningEpisode
from bojax.experiments.settings import Planning
from bojax.planning.random import RandomPlanner
from bojax.surveys.lawnmower_planner import Lawnmower
from bojax.surveys.polylines import length_of
from bojax.surveys.settings import Lawnmower as LawnmowerSettings
from tests.arrays import f64
from tests.planning.samples import field_belief, kernel_trajectories, monitoring, parking

BORDER = [[0.0, 0.0], [3.0, 0.0], [3.0, 2.4], [0.0, 2.4], [0.0, 0.0]]
HOLE = [[1.0, 0.8], [1.8, 0.8], [1.8, 1.5], [1.0, 1.5], [1.0, 0.8]]
FREE = shapely.Polygon(BORDER, [HOLE])
START, END = (0.2, 0.3, 0.5), (2.8, 0.2)
BUDGET = 12.0


@pytest.fixture
def area(tmp_path):
    polygon = {"type": "Polygon", "coordinates": [BORDER, HOLE], "crs": None}
    (tmp_path / "area.geojson").write_text(json.dumps(polygon))
    return OutlinedArea(str(tmp_path / "area.geojson"), resolution=60)


def laid(problem, **settings):
    planner = PlanningEpisode(problem, Lawnmower(f64(0.6), 6, **settings)).planner
    assert isinstance(planner, Lawnmower)
    return planner


def apart(route):
    """The largest distance of a point of the area from the route."""
    points = shapely.points(np.random.default_rng(0).uniform([0.0, 0.0], [3.0, 2.4], (500, 2)))
    return shapely.distance(shapely.LineString(route), points[shapely.covers(FREE, points)]).max()


@pytest.mark.parametrize("limits", [{"budget": f64(BUDGET), "end": f64(END)}, {"max_steps": 20}])
def test_a_route_covers_an_area_with_a_hole_and_ends_within_the_budget(area, limits):
    problem = monitoring(walls=None, target_area=None, start=START, area=area, **({"max_steps": 25} | limits))
    route = np.asarray(laid(problem).waypoints)
    np.testing.assert_allclose(route[0], START[:2])
    length = length_of(route) / (1 if "end" in limits else 2)  # without an end, the way back follows
    assert 0.7 * BUDGET < length <= BUDGET + 1e-9
    assert shapely.covers(FREE.buffer(1e-6), shapely.LineString(route))
    # Lines that fill the budget are this far from each other.
    assert apart(route) < 1.2 * FREE.area / BUDGET
    np.testing.assert_allclose(route[-1], END if "end" in limits else START[:2], atol=1e-6)


def test_lines_have_the_spacing_and_direction_that_are_set(area):
    problem = monitoring(walls=None, target_area=None, start=START, max_steps=200)
    route = np.asarray(laid(problem, spacing=f64(0.4), direction=f64(math.pi / 2)).waypoints)
    long = np.diff(route, axis=0)[1:]
    long = long[np.linalg.norm(long, axis=1) > 1.0]
    np.testing.assert_allclose(long[:, 0], 0.0, atol=1e-9)
    assert len(long) == 2 * math.ceil(3.0 / 0.4)  # to and back
    short = monitoring(walls=None, target_area=None, start=START, max_steps=5)
    assert length_of(np.asarray(laid(short, spacing=f64(0.4)).waypoints)) <= 2 * 5 * 0.6 + 1e-9


def test_the_way_from_a_random_start_leads_around_walls_to_the_first_line():
    problem = monitoring(target_area=None, max_steps=20)  # two rooms with a gap
    planner = laid(problem)
    room = (0.3, 0.3) if float(planner.waypoints[0, 0]) > 1.4 else (2.7, 0.3)
    pose = np.array([*room, 0.0])
    driven, step = [pose[:2]], 0.1
    for count in range(1, 60):
        belief = field_belief(problem, pose, 0)
        if count > 1:  # the first sample tells where the robot began
            first = belief.posterior.x.at[0].set(driven[1])
            belief = eqx.tree_at(
                lambda belief: (belief.posterior.x, belief.step), belief, (first, belief.step + 1)
            )
        points = planner.points(belief, f64([count * step]), f64(step))
        driven.append(np.asarray(points[0]))
    walls = shapely.union_all([shapely.box(*wall) for wall in np.asarray(problem.walls)])
    assert not shapely.intersects(walls, shapely.LineString(driven))
    assert np.linalg.norm(np.array(driven) - np.asarray(planner.waypoints[0]), axis=1).min() < 1e-9
    assert np.linalg.norm(np.diff(driven, axis=0), axis=1).max() < 2.0 * step


def test_it_refuses_what_is_no_field():
    with pytest.raises(ValueError, match="a route is followed on a field"):
        laid(parking())
    with pytest.raises(ValueError, match="lawnmower, which follows a route on a field, and parking has no"):
        Planning(planner=LawnmowerSettings())


@pytest.mark.slow
def test_a_lawnmower_makes_a_better_map_than_random_paths(area):
    problem = monitoring(
        walls=None, target_area=None, start=START, area=area, budget=f64(9.0), end=f64(END), max_steps=15
    )

    def outcome(planner):
        episode = PlanningEpisode(problem, planner)

        @eqx.filter_jit
        def run(key):
            carry = episode.init(key)
            carry, _ = jax.lax.scan(lambda carry, _: (episode.advance(carry)[0], None), carry, length=15)
            return episode.summary(carry), carry.world.distance, carry.belief.pose

        with jax.debug_key_reuse(False):
            return [run(key) for key in jax.random.split(jax.random.key(0), 6)]

    mown, drawn = outcome(Lawnmower(f64(0.6), 6)), outcome(RandomPlanner(kernel_trajectories()))
    assert all(scores["collisions"] == 0 and distance <= 9.0 + 1e-9 for scores, distance, _ in mown)
    assert all(np.allclose(pose[:2], END, atol=1e-6) for *_, pose in mown)
    assert np.mean([each[0]["rmse"] for each in mown]) < 0.8 * np.mean([each[0]["rmse"] for each in drawn])
