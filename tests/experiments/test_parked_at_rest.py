"""Success in parking is that of the true pose at rest, which steps, paths, frames and films end with."""

from functools import partial
from math import hypot, sin

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.films.planning import PlanningFilm
from bojax.films.recorded import choose_drive
from bojax.problems.settings import Parking
from bojax.problems.vehicles.settings import Exact, Quadrotor, WheeledRobot
from bojax.report.source import Results, load
from bojax.robots.quaternions import yaw_of
from tests.compiling import REPEATABLY
from tests.motions.families import wrapped
from tests.runs import run

NUM_RUNS = 24
LENIENT = {"distance_tolerance": 0.4, "heading_tolerance": 0.9, "bearing_tolerance": 0.9}
"""Tolerances at which some of these runs park."""

SMALL = ["planner.iterations=40", *(f"problem.{name}={value}" for name, value in LENIENT.items())]
CASES = {
    "simulated": ("robot-parking", *SMALL),
    "noisy": ("parking", *SMALL, "problem.half_width=1.5", "problem.position_noise=0.3"),
}


@pytest.fixture(scope="module", params=CASES)
def results(request, tmp_path_factory) -> Results:
    """A few runs under the default rule, all of them recorded."""
    words = [*CASES[request.param], f"record.runs={NUM_RUNS}", "--runs", str(NUM_RUNS)]
    return load(run(tmp_path_factory.mktemp("parked") / "results", *words))


def is_parked(x: float, y: float, heading: float) -> bool:
    """(4.13): all three conditions, with the bearing of the robot seen from the spot."""
    distance = hypot(x, y)
    return (
        distance <= LENIENT["distance_tolerance"]
        and abs(sin(heading)) <= LENIENT["heading_tolerance"]
        and abs(y) <= LENIENT["bearing_tolerance"] * distance
    )


def last_poses(results: Results) -> np.ndarray:
    """The pose of each run after its last step, from steps.parquet."""
    steps = results.steps
    columns = np.stack([steps[name] for name in ("x", "y", "heading")], axis=-1)
    return np.stack([columns[np.flatnonzero(steps["run"] == number)[-1]] for number in range(NUM_RUNS)])


def test_a_run_succeeds_if_and_only_if_it_ends_parked(results):
    success, exits = (np.asarray(results.runs[name]) for name in ("success", "exits"))
    parked = np.asarray([is_parked(*pose) for pose in last_poses(results).tolist()])
    np.testing.assert_array_equal(success, parked & (exits == 0))
    assert 3 <= success.sum() < NUM_RUNS


def test_steps_paths_frames_and_films_end_at_one_pose(results):
    (point,) = results.points
    kept = dict(results.arrays(point, "paths"))
    poses = last_poses(results)
    for number, pose in enumerate(poses):
        drive = choose_drive(results, 0, number)
        paths = kept[number]["paths"]
        last = np.isfinite(paths[:, 0, 0]).sum() - 1
        ends = [paths[last, -1], PlanningFilm(drive)._curves[-1][-1]]
        if "frames" in kept[number]:
            qpos = kept[number]["frames"][last, -1]
            yaw = float(yaw_of(jnp.asarray(qpos[3:7])))
            ends.append(np.asarray([*qpos[:2], yaw]))
        for end in ends:
            np.testing.assert_allclose(end[:2], pose[:2], atol=1e-5)
            assert abs(wrapped(end[2] - pose[2])) < 1e-4


VEHICLES = [Exact(), WheeledRobot(), WheeledRobot(readings=51), Quadrotor(rest_steps=255)]
"""Also with numbers of readings and of steps at which the last one is no frame, counted from the first."""


@pytest.mark.parametrize("vehicle", VEHICLES, ids=["exact", "wheeled", "wheeled, odd", "quadrotor, odd"])
def test_a_path_ends_at_rest_where_its_outcome_is_decided(vehicle):
    problem = build(Parking(vehicle=vehicle, position_noise=0.05, heading_noise=0.1))
    turn = np.linspace(0.1, 1.0, 10)
    path = jnp.asarray(np.stack([np.sin(turn), 1.0 - np.cos(turn), turn], axis=-1))

    @jax.jit
    def drive(key):
        world = problem.vehicle.reset(jnp.asarray([-0.5, 0.3, 0.2]))
        after, reading, events = problem.execute(key, world, path)
        decided = problem.outcome(problem.pose(world), events.driven)
        return after, problem.pose(after), problem.vehicle.estimate(after), reading, events, decided

    after, pose, estimate, reading, events, decided = jax.device_get(drive(jax.random.key(0)))
    np.testing.assert_allclose(events.driven[-1, :2], pose[:2], atol=1e-12)
    assert abs(wrapped(events.driven[-1, 2] - pose[2])) < 1e-12
    assert events.reward == decided.reward and events.success == decided.success
    assert np.abs(reading - pose).max() > 0.01
    if events.frames is not None:
        np.testing.assert_array_equal(events.frames[-1], after.robot.qpos)
        np.testing.assert_array_equal(reading, estimate)  # it plans from where it takes itself to be
        assert np.linalg.norm(after.robot.qvel[:2]) < 0.01


STRAIGHT = np.stack([np.linspace(0.1, 1.0, 10), np.zeros(10), np.zeros(10)], axis=-1)


def test_a_simulated_robot_that_passes_the_spot_drives_on():
    """It is recorded where it comes to rest, and parks on the way only if the rule has it so."""

    @partial(jax.jit, compiler_options=REPEATABLY)
    def drive(problem, key):
        world = problem.vehicle.reset(jnp.asarray([-0.5, 0.0, 0.0]))
        after, _, events = problem.execute(key, world, jnp.asarray(STRAIGHT))
        return problem.pose(after), events

    for rule in ("printed", "anywhere-bearing-dropped"):
        problem = build(Parking(vehicle=WheeledRobot(), rule=rule, position_noise=0.0, heading_noise=0.0))
        pose, events = jax.device_get(drive(problem, jax.random.key(0)))
        np.testing.assert_allclose(pose[:2], [0.5, 0.0], atol=0.02)
        np.testing.assert_allclose(events.driven[-1], [*pose[:2], wrapped(pose[2])], atol=1e-6)
        assert events.success == (rule != "printed")


def test_the_truth_counts_and_not_the_belief():
    problem = build(Parking(position_noise=1.0, heading_noise=1.0))
    starts = jnp.asarray([[-1.05, 0.0, 0.0], [-1.05, 0.5, 0.0]])
    after, readings, events = jax.device_get(
        jax.jit(jax.vmap(problem.execute, in_axes=(0, 0, None)))(
            jax.random.split(jax.random.key(0), 2), starts, STRAIGHT
        )
    )
    np.testing.assert_array_equal(events.success, [True, False])
    np.testing.assert_allclose(after[:, :2], [[-0.05, 0.0], [-0.05, 0.5]], atol=1e-12)
    assert np.all(np.linalg.norm(readings - after, axis=-1) > 0.3)
