"""Missions of several robots: planned together, apart from each other, each within its own budget."""

import numpy as np
import pytest

from bojax.surveys.polylines import length_of, points_along
from bojax.surveys.route import stays_inside
from bojax.surveys.team import keep_separation, least_distance
from tests.compiling import COMPILATION, events_of_jax
from tests.surveys.test_mission import SQUARE, assert_same_plan, drive, mission, resumed

SEPARATION = 0.6
CORNERS = [[0.5, 0.5], [5.5, 0.5]]


def team(**changes):
    return mission(**({"robots": 2, "separation": SEPARATION, "start": CORNERS} | changes))


def ways(survey):
    """The next plan of each robot, from its position."""
    plans = survey.plan() if len(survey.robots) > 1 else [survey.plan()]
    pairs = zip(survey.robots, plans, strict=True)
    return [np.concatenate([robot.position[None], waypoints]) for robot, waypoints in pairs]


@pytest.mark.parametrize("goal", ["map", "hotspots"])
def test_robots_keep_apart_and_in_their_budgets_until_they_are_used(goal):
    survey = team(goal=goal, end=CORNERS, budget=8.0)
    driven, steps = np.zeros(2), (3.0, 2.0)  # the second robot is slower than it was planned to be
    for _ in range(4):
        together = ways(survey)
        assert keep_separation(together, SEPARATION)
        for index, (robot, way) in enumerate(zip(survey.robots, together, strict=True)):
            assert length_of(way) <= robot.remaining * (1.0 + 1e-9)
            assert len(way) == 1 or np.allclose(way[-1], CORNERS[index])
            assert stays_inside(way, SQUARE)
            driven[index] += drive(survey, way[1:], steps[index], index)
        survey.relearn()
    assert np.all(driven <= 8.0 * (1.0 + 1e-9))
    for robot, corner in zip(survey.robots, CORNERS, strict=True):
        np.testing.assert_allclose(robot.position, corner, atol=SEPARATION)
        assert robot.remaining == pytest.approx(0.0, abs=SEPARATION)


@pytest.mark.parametrize("goal", ["map", "hotspots"])
def test_robots_from_one_mooring_do_not_measure_the_same(goal):
    survey = mission(robots=2, start=[3.0, 0.5], goal=goal)
    first, second = (points_along(way, np.arange(0.3, 12.0, 0.3)) for way in ways(survey))
    gaps = np.linalg.norm(first[:, None] - second, axis=2).min(axis=1)
    assert np.median(gaps) > 0.5


def test_two_robots_map_better_than_one_with_the_same_budget():
    points = SQUARE.grid(0.3)

    def deviation(robots):
        survey = mission(robots=robots, start=[3.0, 0.5], lengthscale=1.0)
        for index, way in enumerate(ways(survey)):
            drive(survey, way[1:], 12.0, index)
        return survey.predict(points)[1].mean()

    assert deviation(2) < 0.9 * deviation(1)


def test_a_mission_of_one_robot_is_that_without_the_argument():
    usual = mission()
    with pytest.warns(UserWarning, match="^separation: got 3 m, which one robot does not use$"):
        counted = mission(robots=1, separation="3", start=[[1.0, 1.0]])
    # Sums over points have no fixed order on a GPU.
    np.testing.assert_allclose(usual.plan(), counted.plan(), rtol=1e-12)


@pytest.mark.parametrize("make", [mission, team])
def test_a_second_plan_compiles_nothing(make):
    survey = make()
    for _ in range(2):
        for index, way in enumerate(ways(survey)):
            drive(survey, way[1:], 2.0 + index, index)
    with events_of_jax() as events:
        survey.plan()
    assert COMPILATION not in events


def test_a_robot_whose_budget_is_used_stays_while_the_other_goes_on():
    survey = team()
    survey.robots[0].remaining = 0.0
    done, going = survey.plan()
    assert done.shape == (0, 2)
    assert length_of(np.concatenate([survey.robots[1].position[None], going])) > 6.0
    survey.robots[1].remaining = 0.1
    assert [len(each) for each in survey.plan()] == [0, 0]


@pytest.mark.parametrize("goal", ["map", "hotspots"])
def test_a_robot_keeps_away_from_one_that_returns(goal):
    # Both diagonals: without it, the second robot meets the first one in the middle.
    survey = team(goal=goal, start=[[1.0, 5.0], [5.0, 5.0]], end=[[5.0, 1.0], [1.0, 1.0]], separation=1.0)
    survey.observe([[1.1, 5.0], [5.0, 5.1]], [1.0, 2.0], [1.0, 5.0], robot=0)
    survey.robots[0].remaining = 5.65  # less than the way to its end
    survey.robots[1].remaining = 8.0 if goal == "map" else 6.5
    together = ways(survey)
    np.testing.assert_allclose(together[0], [[1.0, 5.0], [5.0, 1.0]])
    np.testing.assert_allclose(together[1][[0, -1]], [[5.0, 5.0], [1.0, 1.0]])
    assert least_distance(together, 1.0) >= 1.0 - 1e-9


def test_a_team_that_is_saved_between_two_steps_goes_on(tmp_path):
    survey = team(end=[3.0, 3.0])
    for index, waypoints in enumerate(survey.plan()):
        drive(survey, waypoints, 3.0 + index, index)
    survey.observe([], [], times=[], robot=1)
    other = resumed(survey, tmp_path)
    assert other.separation == SEPARATION
    for ours, theirs in zip(survey.robots, other.robots, strict=True):
        assert ours.remaining == theirs.remaining
        np.testing.assert_array_equal(ours.position, theirs.position)
        np.testing.assert_array_equal(ours.end, theirs.end)
    assert_same_plan(other, survey)


def test_measurements_belong_to_their_robot():
    survey = team(start=[1.0, 1.0], robots=2.0)
    survey.observe([[2.0, 1.0]], [1.0], times=[5.0], robot=1)
    survey.observe([[1.0, 3.0]], [1.0], times=[4.0], robot=0)
    survey.observe([[2.0, 1.5]], [1.0], times=[4.0], robot=1.0)
    assert survey.counts["time_backwards"] == 1
    assert [robot.remaining for robot in survey.robots] == pytest.approx([10.0, 10.5])
    np.testing.assert_array_equal([robot.position for robot in survey.robots], [[1.0, 3.0], [2.0, 1.5]])
    with pytest.raises(ValueError, match="robot: got 2; allowed: 0 to 1"):
        survey.observe([], [], robot=2)
    with pytest.raises(ValueError, match="robot: got None; allowed: 0 to 1"):
        survey.observe([[1.0, 3.5]], [1.0])
    assert survey.num_measurements == 3


@pytest.mark.parametrize("goal", ["map", "hotspots"])
def test_a_separation_that_cannot_be_kept_is_one_line(goal):
    survey = team(separation=20.0, start=[1.0, 1.0], budget=60.0, goal=goal)
    with pytest.raises(ValueError, match="separation: got 20 m, which no .* keeps; allowed: a smaller one"):
        survey.plan()


def test_only_common_ends_are_left_out_of_the_least_distance():
    first = np.array([[0.0, 0.0], [10.0, 0.0]])
    near = first + [0.0, 0.5]
    assert least_distance([first, near], 1.0) == pytest.approx(0.5)
    # Together at the start only: they come apart.
    apart = np.array([[0.0, 0.5], [0.0, 10.5]])
    assert least_distance([first, apart], 1.0) == pytest.approx(np.hypot(2.0, 2.5))
    # Routes that start apart are compared from the first metre on.
    crossing = np.array([[0.4, 1.2], [0.4, 0.0], [0.4, -8.8]])
    times = np.linspace(0.0, 10.0, 10001)
    expected = np.hypot(times - 0.4, 1.2 - times).min()
    assert expected < 0.6
    assert least_distance([first, crossing], 1.0) == pytest.approx(expected, abs=1e-3)
    # A robot that stays at the common end is in nobody's way there.
    short, long = np.array([[8.0, 0.0], [10.0, 0.0]]), np.array([[10.0, 9.0], [10.0, 0.0]])
    assert least_distance([short, long], 1.0) == pytest.approx(2.0)
