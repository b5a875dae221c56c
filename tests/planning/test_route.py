"""Following a route: its pieces beside plain NumPy, and what is refused."""

import dataclasses

import jax
import numpy as np
import pytest

from bojax.motions.base import place
from bojax.planning.route import RouteFollower
from tests.planning.samples import f64, field_belief, monitoring, parking
from tests.refusals import assert_refused

ROUTE = np.array([[0.2, 0.2], [2.5, 0.2], [2.5, 0.57], [0.3, 0.9]])
LENGTH, SIZE = 0.8, 5


@pytest.fixture
def follower(tmp_path):
    np.savetxt(tmp_path / "way.csv", ROUTE, delimiter=",", header="x,y", comments="")
    return RouteFollower(str(tmp_path / "way.csv"), f64(LENGTH), SIZE)


def reference_points(step):
    """Points of the route after `step` pieces, at equal distances but for those near a corner."""
    corners = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(ROUTE, axis=0), axis=1)))
    points = []
    for index in range(1, SIZE + 1):
        at = step * LENGTH + index * LENGTH / SIZE
        near = min(corners, key=lambda corner: abs(corner - at))
        at = min(near if abs(near - at) <= LENGTH / SIZE / 2 else at, corners[-1])
        leg = min(int(np.searchsorted(corners, at, side="right")) - 1, len(ROUTE) - 2)
        share = (at - corners[leg]) / (corners[leg + 1] - corners[leg])
        points.append(ROUTE[leg] + share * (ROUTE[leg + 1] - ROUTE[leg]))
    return np.array(points)


def test_pieces_of_a_route_are_driven_one_after_the_other(follower):
    problem = monitoring(walls=None, target_area=None)
    plan = jax.jit(lambda belief: follower.plan(jax.random.key(0), problem, belief))
    visited = []
    for step in range(8):
        pose = (0.4, 1.3, 2.0 + step)  # the route is followed from anywhere
        belief = dataclasses.replace(field_belief(problem, pose, 0), step=jax.numpy.int32(step))
        found = plan(belief)
        path = np.asarray(place(found.path, f64(pose)))
        np.testing.assert_allclose(path[:, :2], reference_points(step), atol=1e-12)
        away = np.diff(np.concatenate([[pose[:2]], path[:, :2]]), axis=0)
        moves = np.linalg.norm(away, axis=1) > 1e-9
        turn = np.arctan2(away[:, 1], away[:, 0]) - path[:, 2]
        np.testing.assert_allclose(np.cos(turn[moves]), 1.0, atol=1e-9)
        visited.append(path[:, :2])
    gaps = np.linalg.norm(np.concatenate(visited)[:, None] - ROUTE[None, 1:], axis=-1).min(axis=0)
    np.testing.assert_allclose(gaps, 0.0, atol=1e-9)  # every corner is a pose


def test_what_cannot_be_followed_is_refused(tmp_path, follower):
    (tmp_path / "one.csv").write_text("x,y\n1,2\n")
    (tmp_path / "wide.csv").write_text("1,2,3\n4,5,6\n")
    ending = monitoring(walls=None, end=f64([1.0, 1.0]), budget=f64(9.0), max_steps=4)
    assert_refused(
        [
            (lambda: RouteFollower(str(tmp_path / "one.csv"), f64(1.0)), "got 1 rows and 2 columns"),
            (lambda: RouteFollower(str(tmp_path / "wide.csv"), f64(1.0)), "got 2 rows and 3 columns"),
            (lambda: follower.check(parking()), "a route is followed on a field"),
            (lambda: follower.check(ending), "planner.length: got 0.8; allowed: >= 2.25"),
        ]
    )
