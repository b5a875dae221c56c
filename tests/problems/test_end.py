"""A mission with an end point: it is reached within the budget, and planners know the way there."""

import dataclasses
import re
import shlex

import jax
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.motions.polylines import points_along
from bojax.problems.settings import Monitoring
from tests.planning.samples import f64, monitoring
from tests.problems.test_budget import START, simulated_and_driven
from tests.problems.test_monitoring import SIZE, drives

BUDGET, END = 2.4, np.array([0.4, 0.4])
HOMING = monitoring(walls=None, target_area=None, budget=f64(BUDGET), end=f64(END))


def reference_drive(start, poses, is_driven, left):
    """Positions driven, and what is left: as far as the end can be reached, else straight to the end."""
    to_end = np.linalg.norm(END - start[:2])
    if left <= to_end + 1e-9:
        ways, step = [], 1.0 / SIZE
        for index in range(SIZE):
            way = step * (index + 1)
            ways.append(to_end if way >= to_end - step / 2 else way)
            if ways[-1] == to_end:
                break
        points = start[:2] + np.array(ways)[:, None] / to_end * (END - start[:2])
        return points, to_end - ways[-1]
    at, points = start[:2], []
    for pose, driven in zip(poses, is_driven, strict=True):
        if not driven:
            break
        gap = np.linalg.norm(pose[:2] - at)
        if gap + np.linalg.norm(END - pose[:2]) > left + 1e-9:
            return np.array(points).reshape(-1, 2), np.linalg.norm(END - at)
        at, left = pose[:2], left - gap
        points.append(at)
    return np.array(points).reshape(-1, 2), left


@jax.jit
def cut(start, path, left):
    arena = HOMING.arena
    return arena.drive(start, path), *arena.drive_within(start, path, left)


@pytest.mark.parametrize("spare", [0.0, 0.15, 0.6, 3.0])
def test_a_drive_is_cut_where_the_end_is_just_in_reach(spare):
    for start, path in zip(*drives(100, seed=5), strict=True):
        left = np.linalg.norm(END - start[:2]) + spare
        whole, part, rest = jax.tree.map(np.asarray, cut(start, path, np.asarray(left)))
        points, expected = reference_drive(start, whole.poses, whole.is_driven, left)
        np.testing.assert_array_equal(part.is_driven, np.arange(SIZE) < len(points))
        np.testing.assert_allclose(part.poses[: len(points), :2], points, atol=1e-9)
        np.testing.assert_allclose(rest, expected, atol=1e-8)


def test_simulations_and_the_world_end_at_the_point():
    _, _, driven = simulated_and_driven(HOMING, 4)
    points = [np.asarray(events.driven)[np.asarray(events.is_driven), :2] for _, _, events in driven]
    way = np.concatenate([[START[:2]], *points])
    np.testing.assert_allclose(way[-1], END, atol=1e-9)
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() <= BUDGET + 1e-9
    assert all(events.success == events.terminated for _, _, events in driven)


def test_a_robot_that_stays_drives_to_the_end():
    world = dataclasses.replace(HOMING, start=f64([1.0, 0.4, 0.0]), noise=f64(0.0)).reset(jax.random.key(0))
    execute, found = jax.jit(type(HOMING).execute), []
    for _ in range(2):
        world, samples, events = execute(HOMING, jax.random.key(2), world, f64(np.zeros((SIZE, 3))))
        found.append((samples.pose[:2].tolist(), float(world.left), bool(events.success)))
    np.testing.assert_allclose(found[0][0], [1.0, 0.4])
    assert found[0][1:] == (pytest.approx(0.6), False)
    np.testing.assert_allclose(found[1][0], END)
    assert found[1][1:] == (0.0, True)


def test_points_along_a_polyline_include_its_corners():
    corners = np.array([[0.0, 0.0], [1.05, 0.0], [1.05, 0.9], [1.05, 0.9]])
    points, moved = points_along(f64(corners), f64([0.5, 1.0, 1.5, 2.0, 2.5]), f64(0.5))
    np.testing.assert_allclose(moved, [0.5, 1.05, 1.5, 1.95, 1.95])
    np.testing.assert_allclose(points, [[0.5, 0.0], [1.05, 0.0], [1.05, 0.45], [1.05, 0.9], [1.05, 0.9]])


def test_a_time_at_a_speed_is_a_budget():
    ends = {"start": (3.0, 3.0, 0.0), "end": (1.0, 2.0)}
    by_time, by_distance = Monitoring(time_budget=8.6, speed=0.5, **ends), Monitoring(budget=4.3, **ends)
    left = [build(settings).reset(jax.random.key(0)).left for settings in (by_time, by_distance)]
    assert left == [4.3, 4.3]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("end=[1,1]", "end: needs a budget, or time_budget and speed"),
        ("budget=9 end=[7,1]", "end: \\(7, 1\\) lies outside the domain"),
        ("budget=9 end=[4,1] walls=[[3.5,0.5,5,2]]", "end: \\(4, 1\\) lies inside walls\\[0\\]"),
        ("budget=1 end=[4,5] start=[1,1,0]", "budget: got 1; allowed: >= 5 m, to get from the start"),
        ("time_budget=1 speed=2 end=[4,5] start=[1,1,0]", "time_budget: got 1; allowed: >= 2.5 s"),
        ("budget=7 end=[0,0] start=null", "budget: got 7; allowed: >= 8.485 m, to get from any start"),
        ("time_budget=5", "speed: got null; allowed: a number, since time_budget and speed go together"),
        ("speed=1", "time_budget: got null; allowed: a number"),
        ("time_budget=5 speed=0", "speed: got 0; allowed: > 0"),
        ("budget=5 time_budget=5 speed=1", "time_budget: not with budget; allowed: one of the two"),
        ("budget=9 end=[1,1] vehicle=wheeled-robot after_collision=stop", "end: the vehicle cannot turn"),
    ],
)
def test_wrong_budgets_and_ends_are_refused_in_one_line(here, refusal, settings, message):
    words = [f"problem.{each}" for each in settings.split()]
    if "walls" not in settings:
        words.append("problem.walls=null")
    if "wheeled" in settings:
        words += ["planner.motions.first_angle=0.3", "planner.motions.turn_angle=0.3"]
    assert re.search(message, refusal(shlex.join(["run", "space-modelling", *words, "--runs", "1"])))
