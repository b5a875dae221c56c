"""A mission goes on: what is observed enters the belief, the budget holds, and a killed process resumes."""

import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest

from bojax.areas.area import Area
from bojax.surveys.mission import Mission
from bojax.surveys.polylines import length_of, points_along, rest_of
from bojax.surveys.route import RouteOptions, stays_inside
from tests.compiling import IS_CPU

QUICK = RouteOptions(waypoints=12, restarts=4, steps=8, models=1)
SQUARE = Area.rectangle(0.0, 0.0, 6.0, 6.0)


def mission(**changes):
    given = {"area": SQUARE, "budget": 12.0, "start": [1.0, 1.0], "spacing": 0.3, "options": QUICK}
    return Mission(**(given | changes))


def field(points):
    return 100.0 + 20.0 * np.sin(points[:, 0]) * np.cos(0.7 * points[:, 1])


def resumed(survey, tmp_path):
    """The mission in the file that a mission is saved to."""
    survey.save(tmp_path / "mission.npz")
    return Mission.load(tmp_path / "mission.npz")


def drive(survey, waypoints, distance, robot=None):
    """Follow waypoints for a distance, measuring on the way, and return the length that the mission sees."""
    way = np.concatenate([survey.robots[robot or 0].position[None], waypoints])
    at = np.arange(survey.spacing, min(distance, length_of(way)) + 1e-9, survey.spacing)
    points, end = points_along(way, at), points_along(way, np.array([distance]))
    survey.observe(points, field(points), end[0], robot=robot)
    return length_of(np.concatenate([way[:1], points, end]))


def test_the_whole_budget_is_driven_and_the_field_is_learned():
    survey = mission(end=[5.0, 5.0], relearn_every=10)
    error_before = np.std(field(SQUARE.grid(0.5)))
    driven = sum(drive(survey, survey.plan(), 3.0) for _ in range(6))
    assert driven <= 12.0 * (1.0 + 1e-9)
    np.testing.assert_allclose(survey.position, [5.0, 5.0], atol=0.35)
    mean, deviation = survey.predict(SQUARE.grid(0.5))
    assert np.sqrt(np.mean((mean - field(SQUARE.grid(0.5))) ** 2)) < 0.7 * error_before
    assert np.all(deviation > 0.0)
    assert survey.num_measurements > 30


@pytest.mark.parametrize("robots", [1, 2])
def test_measurements_of_others_cost_nothing_and_move_no_robot(robots):
    survey = mission(robots=robots, start=[[1.0, 1.0], [5.0, 5.0]][:robots])
    points = SQUARE.grid(1.0)
    assert survey.observe(points, field(points), [3.0, 3.0], driven=False) == len(points)
    for robot, start in zip(survey.robots, (1.0, 5.0), strict=False):
        assert robot.remaining == 12.0
        np.testing.assert_array_equal(robot.position, [start, start])
    assert survey.num_measurements == len(points) and not any(survey.counts.values())


def test_a_corner_without_a_value_counts_as_driven():
    survey, corner = mission(), [3.0, 1.0]
    survey.observe([[2.0, 1.0], corner, [3.0, 2.0]], [1.0, np.nan, 2.0])
    assert survey.remaining == pytest.approx(12.0 - 3.0)


def test_the_belief_has_room_for_the_measurements_of_the_budget_and_outgrows_it(tmp_path):
    survey = mission(budget=40.0)  # 133 measurements
    assert survey.posterior().y.shape == (256,)
    assert resumed(survey, tmp_path).posterior().y.shape == (256,)
    assert mission(budget=400.0).posterior().y.shape == (256,)
    survey, points = mission(), np.random.default_rng(0).uniform(0.0, 6.0, (150, 2))
    survey.observe(points, field(points), [1.0, 1.0])
    assert survey.posterior().y.shape == (256,) and int(survey.posterior().count) == 150


def test_a_plan_from_many_measurements_has_as_many_guesses_as_the_program(monkeypatch):
    survey, given = mission(budget=4000.0), []
    points = np.random.default_rng(0).uniform(0.0, 6.0, (300, 2))
    survey.observe(points, field(points), [1.0, 1.0])
    monkeypatch.setattr("bojax.surveys.mission.lawnmower_guesses", lambda *args: given.append(args[-1]) or {})
    survey.plan()
    assert given == [QUICK.restarts // 2]


def test_what_cannot_be_used_is_counted():
    survey = mission()
    points = [[1, 1], [1.1, 1], [1.2, 1], [1.2, 1], [900, 1], [np.nan, 1], [1.3, 1]]
    values = [1.0, np.nan, 3.0, 3.0, 5.0, 6.0, 7.0]
    assert survey.observe(points, values, [1e9, 0.0, 0.0], times=[0, 1, 2, 3, 2, 5, 6]) == 3
    assert survey.counts == {
        "not_finite": 2,
        "duplicate": 1,
        "far_off": 1,
        "bad_pose": 1,
        "time_backwards": 1,
    }
    np.testing.assert_allclose(survey.position, [1.3, 1.0])
    assert survey.remaining == pytest.approx(12.0 - 0.3)
    survey.observe([], [], [9.1, 1.0])
    assert survey.counts["bad_pose"] == 2
    survey.observe([], [], [8.9, 1.0])
    np.testing.assert_allclose(survey.position, [8.9, 1.0])


@pytest.mark.parametrize("factor", [1.0, 1e9])
def test_values_of_any_scale_are_mapped(factor):
    survey = mission()
    points = np.random.default_rng(0).uniform(0.0, 6.0, (40, 2))
    assert survey.observe(points, factor * field(points)) == 40
    survey.relearn()
    mean, _ = survey.predict(points)
    np.testing.assert_allclose(mean, factor * field(points), atol=6.0 * factor)


def test_values_that_stand_for_missing_data_and_what_is_masked_are_counted():
    survey = mission()
    assert survey.observe([[1.1, 1.0], [1.2, 1.0], [1.3, 1.0]], [-3.4e38, 1e25, 9.97e36]) == 1
    assert survey.counts["too_large"] == 2
    survey = mission()
    points, values = [[1.4, 1.0], [1.5, 1.0], [1.6, 1.0]], np.ma.masked_equal([7.0, 2.0, -9999.0], 7.0)
    assert survey.observe(points, values) == 1
    assert (survey.counts["not_finite"], survey.counts["no_data"]) == (1, 1)
    survey = mission()
    points = np.ma.masked_greater([[1.1, 1.0], [1.2, 1.0], [5.0, 1.0]], 4.0)
    assert survey.observe(points, [1.0, 2.0, 3.0]) == 2 and survey.counts["not_finite"] == 1
    assert survey.remaining == pytest.approx(12.0 - 0.2)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (
            [[[1.1, 1.0], [1.2, 1.0]], [[1.3, 1.0], [1.4, 1.0]]],
            r"got the shape \(2, 2, 2\); allowed: \(N, 2\)",
        ),
        ([1.1, 1.0, 1.2, 1.0], r"got the shape \(4,\); allowed: \(N, 2\), rows of x and y, m"),
        ([[1.1, 1.0, 0.0], [1.2, 1.0, 0.0]], r"got the shape \(2, 3\)"),
        ([[1.1, 1.0], [1.2]], r"not an array of numbers; allowed: \[\[x, y\], ...\], m"),
    ],
)
def test_points_of_another_form_are_refused(points, message):
    survey = mission()
    with pytest.raises(ValueError, match=f"^points: {message}"):
        survey.observe(points, [1.0, 2.0, 3.0, 4.0])
    assert survey.num_measurements == 0 and survey.remaining == 12.0


@pytest.mark.parametrize(
    "change",
    [{"values": ["deep"]}, {"values": [1j]}, {"values": [10**400]}, {"pose": "here"}, {"times": ["noon"]}],
)
def test_an_observation_that_is_not_of_numbers_changes_nothing(change):
    survey = mission()
    (name,) = change
    with pytest.raises(ValueError, match=f"^{name}: not an array of numbers; allowed: "):
        survey.observe(**({"points": [[1.1, 1.0]], "values": [2.0], "times": [-1.0]} | change))
    assert survey.observe([[1.1, 1.0]], [2.0], times=[-2.0]) == 1
    assert not survey.counts["time_backwards"] and survey.remaining == pytest.approx(12.0 - 0.1)


def test_nothing_is_predicted_at_a_point_that_is_not_finite():
    survey = mission()
    survey.observe([[1.1, 1.0], [1.2, 1.0]], [3.0, 4.0])
    mean, deviation = survey.predict([[1.1, 1.0], [np.nan, 1.0], [np.inf, 1.0]])
    np.testing.assert_array_equal(np.isnan(mean), [False, True, True])
    np.testing.assert_array_equal(np.isnan(deviation), [False, True, True])
    with pytest.raises(ValueError, match=r"^points: got the shape \(2,\); allowed: \(N, 2\)"):
        survey.predict([1.1, 1.0])


def test_a_used_budget_ends_the_mission():
    survey = mission(budget=1.0, end=[1.5, 1.0])
    survey.observe([[1.9, 1.0]], [1.0])
    np.testing.assert_allclose(survey.plan(), [[1.5, 1.0]])
    survey = mission(budget=1.0)
    survey.observe([[1.9, 1.0]], [1.0])
    assert survey.plan().shape == (0, 2)


@pytest.mark.parametrize("goal", ["map", "hotspots"])
@pytest.mark.parametrize("budget", [8.0, 9.8])
def test_the_way_to_an_end_behind_a_wall_is_the_plan_of_a_short_budget(goal, budget):
    area = SQUARE.without([(np.array([[2.5, -1.0], [3.5, -1.0], [3.5, 5.0], [2.5, 5.0]]),)])
    survey = mission(area=area, end=[5.0, 1.0], goal=goal)
    survey.robots[0].remaining = budget + 1e-3
    survey.observe([[1.0, 1.001]], [1.0])
    waypoints = survey.plan()
    route = np.concatenate([survey.position[None], waypoints])
    assert stays_inside(route, area)
    np.testing.assert_allclose(route[-1], [5.0, 1.0])
    shortest = 2 * np.hypot(1.5, 4.0) + 1.0
    assert shortest - 2e-3 <= length_of(route) <= max(budget, shortest) + 1e-6
    assert len(waypoints) == 3 or budget > shortest


def test_a_robot_outside_the_area_comes_back():
    survey = mission()
    survey.observe([], [], [-1.0, 3.0])
    waypoints = survey.plan()
    assert SQUARE.contains(waypoints).all()
    assert length_of(np.concatenate([survey.position[None], waypoints])) <= survey.remaining * (1 + 1e-9)


def assert_same_plan(first, second):
    """Compare the next plans of two missions; sums on a GPU have an order of their own in each call."""
    np.testing.assert_allclose(first.plan(), second.plan(), rtol=0.0, atol=0.0 if IS_CPU else 1e-9)


def test_a_process_that_is_killed_between_two_steps_goes_on(tmp_path):
    file = tmp_path / "mission.npz"
    survey = mission(end=[5.0, 5.0])
    drive(survey, survey.plan(), 3.0)
    survey.save(file)
    killed = f"""
        import os, signal
        from bojax.surveys.mission import Mission
        survey = Mission.load({str(file)!r})
        survey.observe([[2.0, 2.0]], [1.0])
        os.kill(os.getpid(), signal.SIGKILL)
    """
    assert subprocess.run([sys.executable, "-c", textwrap.dedent(killed)]).returncode == -9
    resumed = Mission.load(file)
    assert_same_plan(resumed, survey)
    assert resumed.remaining == survey.remaining
    assert resumed.num_measurements == survey.num_measurements


def test_a_damaged_file_is_one_line(tmp_path):
    file = tmp_path / "mission.npz"
    mission().save(file)
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"mission.npz: not a saved mission, or damaged"):
        Mission.load(file)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"area": "square.geojson"},
            "area: got 'square.geojson'; allowed: an Area, such as bojax.read_place",
        ),
        ({"budget": -1.0}, "budget: got -1.0; allowed: a number > 0, m"),
        ({"budget": [50, 60]}, r"budget: got \[50, 60\]; allowed: a number > 0, m"),
        ({"budget": "1km"}, "budget: got 1km; allowed: a number > 0, m"),
        ({"budget": None}, "budget: got None; allowed: a number > 0, m"),
        ({"spacing": 0.0}, "spacing: got 0.0; allowed: a number > 0, m"),
        ({"noise_variance": "low"}, "noise_variance: got low; allowed: a number > 0"),
        (
            {"start": [7.0, 1.0]},
            "start: got 7,1, which is not in the area; allowed: points in it, with x from 0 to 6 and y",
        ),
        ({"end": [1.0, -0.1]}, "end: got 1,-0.1, which is not in the area; allowed: points in it"),
        (
            {"budget": 4.0, "end": [1.0, 5.5]},
            "budget: got 4 m, but the shortest way from the start to the end is 4.5 m long",
        ),
        ({"start": [np.nan, 0.0]}, "start: got .*; allowed: x and y in metres"),
        ({"start": "1,1"}, "start: not an array of numbers; allowed: x and y in metres"),
        ({"end": [[1.0, 1.0], [2.0]]}, "end: not an array of numbers; allowed: x and y in metres"),
        ({"separation": "far"}, "separation: not an array of numbers; allowed: >= 0"),
        ({"separation": [1.0, 2.0]}, r"separation: got \[1.0, 2.0\]; allowed: >= 0"),
        ({"seed": "a"}, "seed: got a; allowed: an integer >= 0"),
        ({"seed": -1}, "seed: got -1; allowed: an integer >= 0"),
        ({"relearn_every": 1.5}, "relearn_every: got 1.5; allowed: a whole number > 0"),
        ({"seed": 2**70}, f"seed: got {2**70}; allowed: an integer >= 0 and < 2\\^63"),
        ({"options": {"steps": 5}}, "options: got {'steps': 5}; allowed: RouteOptions"),
        ({"robots": 0}, "robots: got 0; allowed: 1 to 4"),
        ({"robots": 5}, "robots: got 5; allowed: 1 to 4"),
        (
            {"robots": 3, "start": [[1, 1], [2, 2]]},
            "start: got 2 positions; allowed: one, or one for each robot",
        ),
        ({"robots": 2, "separation": -1.0}, "separation: got -1.0; allowed: >= 0"),
        (
            {"budget": 1e9},
            "budget: got 1e\\+09 m; allowed: at most 60000 m, that of 10,000 lines across the area",
        ),
    ],
)
def test_bad_input_is_one_line(change, message):
    with pytest.raises(ValueError, match=f"^{message}") as caught:
        mission(**change)
    assert "\n" not in str(caught.value)


def test_the_budget_must_reach_around_a_wall_and_may_be_the_way_to_the_end():
    area = SQUARE.without([(np.array([[2.5, -1.0], [3.5, -1.0], [3.5, 5.0], [2.5, 5.0]]),)])
    with pytest.raises(ValueError, match="budget: got 9.5 m, but the shortest way .* is 9.544 m long"):
        mission(area=area, budget=9.5, end=[5.0, 1.0])
    assert mission(area=area, budget=9.55, end=[5.0, 1.0]).remaining == 9.55
    np.testing.assert_allclose(mission(budget=4.0, end=[1.0, 5.0]).plan(), [[1.0, 5.0]])


def test_a_mission_that_has_left_the_area_and_used_its_budget_is_loaded(tmp_path):
    survey = mission(end=[5.0, 5.0])
    survey.observe([], [], [-1.0, 3.0])
    survey.robots[0].remaining = 0.5
    other = resumed(survey, tmp_path)
    assert other.remaining == 0.5
    np.testing.assert_array_equal(other.position, [-1.0, 3.0])
    assert_same_plan(other, survey)


def test_a_mission_with_numbers_of_numpy_is_saved(tmp_path):
    options = replace(QUICK, steps=np.int64(8), turning_radius=np.float32(0.5))
    other = resumed(mission(relearn_every=np.int64(20), options=options), tmp_path)
    assert (other.relearn_every, other.options) == (20, replace(QUICK, turning_radius=0.5))


PART = Area.rectangle(3.0, 3.0, 6.0, 6.0)


@pytest.mark.parametrize(
    "goal", ["hotspots", "threshold=110", PART, PART.without([Area.rectangle(3.0, 3.0, 6.0, 5.0).outline])]
)
def test_a_goal_is_kept(tmp_path, goal):
    survey = mission(goal=goal)
    drive(survey, survey.plan(), 6.0)
    survey.relearn()
    other = resumed(survey, tmp_path)
    assert other.goal.kind == survey.goal.kind
    assert_same_plan(other, survey)


def test_a_mission_for_hot_spots_ends_where_it_has_found_the_field_to_be_high():
    def regret(goal):
        survey = mission(goal=goal, budget=20.0)
        while survey.remaining > survey.spacing:
            drive(survey, survey.plan(), 4.0)
            survey.relearn()
        points = SQUARE.grid(0.2)
        return field(points).max() - field(points)[np.argmax(survey.predict(points)[0])], survey.position

    found, position = regret("hotspots")
    assert found < 1.0
    assert field(position[None])[0] > 110.0  # of at most 120


def test_without_a_measurement_a_plan_spreads_over_the_area_or_the_region_of_its_goal():
    route = mission(goal="threshold=110", budget=20.0).plan()
    assert np.ptp(route, axis=0).min() > 3.0
    route = mission(goal=Area.rectangle(3.0, 3.0, 6.0, 6.0)).plan()
    assert np.median(route, axis=0).min() > 3.0


def test_a_goal_outside_the_area_is_refused():
    with pytest.raises(ValueError, match=r"^goal: no part of its region lies in the area$"):
        mission(goal=Area.rectangle(10.0, 10.0, 12.0, 12.0))


@pytest.mark.parametrize("goal", ["depth", "region=a.kml", "threshold=", "hotspot", "threshold=x", 3])
def test_an_unknown_goal_is_refused(goal):
    allowed = "map, hotspots, threshold=V or an Area$"
    allowed = "threshold=V, where V is a number$" if goal == "threshold=x" else allowed
    with pytest.raises(ValueError, match=f"^goal: got {goal}; allowed: {allowed}"):
        mission(goal=goal)


def test_a_mission_among_walls_has_a_plan_that_stays_inside_from_any_point_of_it():
    walls = [(4.0, 0.0, 5.0, 16.0), (12.0, 4.0, 13.0, 20.0)]
    boxes = [np.array([[x, y], [z, y], [z, w], [x, w]]) for x, y, z, w in walls]
    area = Area.rectangle(0.0, 0.0, 20.0, 20.0).without([(box,) for box in boxes])
    options = RouteOptions(waypoints=16, restarts=2, steps=3, models=1)
    mission = Mission(area, 90.0, [2.0, 2.0], spacing=2.0, options=options)
    for distance in (13.0, 9.5, 17.3):  # the robot stops between waypoints
        way = np.concatenate([mission.position[None], mission.plan()])
        assert stays_inside(way, area) and length_of(way) <= mission.remaining + 1e-6
        points = points_along(way, np.linspace(1.0, distance, 9))
        mission.observe(points, np.sin(points[:, 0]))


def test_the_rest_of_a_plan_begins_behind_the_robot_on_its_own_piece():
    route = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 8.0]])
    np.testing.assert_allclose(rest_of(route, np.array([5.0, 0.0])), [[5, 0], [8, 0], [8, 8]])
    np.testing.assert_allclose(rest_of(route, np.array([8.0, 1.0])), [[8, 1], [8, 8]])
    np.testing.assert_allclose(rest_of(route, np.array([8.0, 8.0])), [[8, 8], [8, 8]])


def test_a_belief_from_many_measurements_is_close_to_the_exact_one_and_plans_are_quick(monkeypatch):
    survey = mission(lengthscale=2.0, noise_variance=0.02)
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, [6.0, 3.0], (900, 2))
    survey.observe(points, np.sin(points[:, 0]) + 0.1 * rng.standard_normal(900), [1.0, 1.0])
    queries = SQUARE.grid(0.5)
    found, exact = survey.predict(queries, 200), survey.predict(queries, 900)
    np.testing.assert_allclose(found[0], exact[0], atol=0.1)
    np.testing.assert_allclose(found[1], exact[1], atol=0.03)
    survey.robots[0].remaining = 12.0
    assert len(survey.posterior().y) == 256
    way = np.concatenate([survey.position[None], survey.plan()])
    # The lower half has been measured: the route is in the upper one.
    length = length_of(way)
    driven = points_along(way, np.linspace(0.0, length, 101))
    assert np.median(driven[:, 1]) > 3.0 and length <= 12.0 + 1e-6
    assert survey.measured.some(survey.seed).count == 256
