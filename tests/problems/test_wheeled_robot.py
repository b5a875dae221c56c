"""The wheeled robot: its turning circle, and how it tracks paths, against C MuJoCo and a tracker in NumPy."""

import re
from functools import partial
from math import atan, pi

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.motions.base import place
from bojax.motions.settings import KernelTrajectories
from bojax.problems.settings import RobotParking
from bojax.problems.vehicles.settings import WheeledRobot
from bojax.problems.vehicles.wheeled_robot import FRAME_EVERY
from bojax.robots.models import packaged
from bojax.robots.pursuit import car_parameters
from tests.compiling import REPEATABLY
from tests.reference import pure_pursuit as reference

SETTINGS = WheeledRobot()
ROBOT = build(SETTINGS)
MODEL = mujoco.MjModel.from_xml_string(packaged("car").xml)
MOTIONS = build(KernelTrajectories(first_angle=0.785, turn_angle=1.257))
reset, estimate, pose_of = (jax.jit(jax.vmap(of)) for of in (ROBOT.reset, ROBOT.estimate, ROBOT.pose))
follow = jax.jit(jax.vmap(lambda *lane: ROBOT.follow(*lane)), compiler_options=REPEATABLY)
NUM_READINGS = SETTINGS.readings + SETTINGS.rest_readings
NUM_LANES, QUIET = 16, 8
"""Lanes from `QUIET` on have noise in their readings."""


def wrapped(angle):
    return (np.asarray(angle) + pi) % (2 * pi) - pi


@pytest.fixture(scope="module")
def drives():
    """Two paths, one after the other, from rest at random poses; of each what `follow` took, and the ride."""
    rng = np.random.default_rng(0)
    starts = jnp.asarray(rng.uniform([-1.5, -1.5, 0.0], [1.5, 1.5, 2 * pi], (NUM_LANES, 3)))
    params = jnp.asarray(rng.uniform(-1.0, 1.0, (2, NUM_LANES, 3)))
    paths = jax.jit(jax.vmap(jax.vmap(MOTIONS.path)))(params)
    noise = jnp.where(jnp.arange(NUM_LANES)[:, None] < QUIET, 0.0, jnp.asarray([[0.02, 0.02, 0.02]]))
    body, done = reset(starts), []
    place_all = jax.jit(jax.vmap(place))
    for number, path in enumerate(paths):
        placed = place_all(path, estimate(body))
        lanes = (jax.random.split(jax.random.key(number), NUM_LANES), body, placed, placed[:, -1], noise)
        done.append((lanes, follow(*lanes)))
        body = done[-1][1].state
    return done


def errors_of(lanes):
    """What the readings of each lane add to its poses."""
    key, _, _, _, noise = lanes
    draw = lambda key: jax.random.normal(key, (NUM_READINGS, 3), jnp.float32)  # noqa: E731
    return np.asarray(noise)[:, None] * np.asarray(jax.vmap(draw)(jax.random.clone(key)), np.float64)


@pytest.fixture(scope="module")
def references(drives):
    """The same in loops of NumPy and C MuJoCo; the second path begins from MJX's state."""
    results = []
    for lanes, _ in drives:
        _, body, path, _, _ = lanes
        done = []
        for lane, errors in enumerate(errors_of(lanes)):
            data = mujoco.MjData(MODEL)
            data.qpos, data.qvel = body.robot.qpos[lane], body.robot.qvel[lane]
            mujoco.mj_kinematics(MODEL, data)
            tracker = SETTINGS.look_ahead, SETTINGS.speed, SETTINGS.gain
            timing = SETTINGS.substeps, SETTINGS.readings
            start = np.asarray(body.reading[lane])
            done.append(
                reference.follow(MODEL, data, start, np.asarray(path[lane]), errors, *tracker, *timing)
            )
        results.append(done)
    return results


@pytest.mark.parametrize("number", [0, 1])
def test_following_is_the_loop_of_the_reference(drives, references, number):
    (_, ride), lanes = drives[number], references[number]
    for lane, (poses, passes, places, reading) in enumerate(lanes):
        expected = reference.at_poses(poses, passes, 10)
        np.testing.assert_allclose(ride.poses[lane, :, :2], expected[:, :2], atol=2e-3)
        np.testing.assert_allclose(wrapped(ride.poses[lane, :, 2] - expected[:, 2]), 0.0, atol=2e-2)
        np.testing.assert_allclose(ride.frames[lane, :, :7], places[FRAME_EVERY::FRAME_EVERY, :7], atol=1e-2)
        np.testing.assert_allclose(ride.state.reading[lane, :2], reading[:2], atol=2e-3)


def test_paths_are_tracked_within_centimetres(drives):
    for lanes, ride in drives:
        path = np.asarray(lanes[2])
        body = lanes[1]
        for lane in range(NUM_LANES):
            points = reference.dense(np.asarray(body.reading[lane]), path[lane])
            fine = np.concatenate(
                [np.linspace(a, b, 20) for a, b in zip(points[:-1], points[1:], strict=True)]
            )
            driven = np.asarray(ride.frames[lane, :, :2])
            across = np.linalg.norm(driven[:, None] - fine[None], axis=-1).min(axis=1)
            assert across.max() < (0.02 if lane < QUIET else 0.06)
        gaps = np.linalg.norm(np.asarray(ride.poses)[..., :2] - path[..., :2], axis=-1)
        assert np.median(gaps[:QUIET]) < 0.02 and np.median(gaps) < 0.03
        off = np.abs(wrapped(np.asarray(ride.poses)[..., 2] - path[..., 2]))
        assert np.median(off[:QUIET]) < 0.05 and np.median(off) < 0.1


def test_a_ride_begins_where_the_one_before_ended(drives):
    (_, first), (lanes, second) = drives
    np.testing.assert_array_equal(lanes[1].robot.qpos, first.state.robot.qpos)
    np.testing.assert_allclose(pose_of(second.state), second.poses[:, -1], atol=1e-12)
    np.testing.assert_allclose(second.frames[:, -1], second.state.robot.qpos, atol=1e-12)


def test_it_is_at_rest_after_every_path(drives):
    (key, body, path, _, noise), _ = drives[0]
    # At twice the length, no path is completed.
    longer = path.at[..., :2].add(path[..., :2] - pose_of(body)[:, None, :2])
    far = follow(jax.random.clone(key), body, longer, longer[:, -1], noise)
    assert np.linalg.norm(far.poses[:, -1, :2] - longer[:, -1, :2], axis=-1).min() > 0.2
    for ride in (*(ride for _, ride in drives), far):
        speeds = np.linalg.norm(ride.state.robot.qvel[:, :2], axis=-1)
        assert speeds.max() < 1e-3 and np.abs(ride.state.robot.qvel[:, 5]).max() < 1e-2


def test_readings_are_poses_with_noise(drives):
    for lanes, ride in drives:
        quiet = wrapped(ride.estimates - ride.poses)[:QUIET]
        np.testing.assert_allclose(quiet, 0.0, atol=1e-6)
        np.testing.assert_array_equal(estimate(ride.state), ride.estimates[:, -1])
        off = np.asarray(ride.estimates - ride.poses)[QUIET:]
        errors = errors_of(lanes)[QUIET:]
        np.testing.assert_allclose(off[:, -1], errors[:, -1], atol=1e-6)
        assert np.all(np.abs(off).max(axis=(1, 2)) > 0.01)


def test_readings_without_noise_are_those_with_a_noise_of_zero(drives):
    (key, body, path, end, _), ride = drives[0]
    few = jax.tree.map(lambda x: x[:2], (jax.random.clone(key), body, path, end))
    exact = jax.jit(jax.vmap(lambda *lane: ROBOT.follow(*lane, None)), compiler_options=REPEATABLY)(*few)
    np.testing.assert_allclose(exact.estimates, ride.estimates[:2], atol=1e-6)


def test_it_stands_where_it_is_placed():
    poses = jnp.asarray([[0.3, -1.2, 0.0], [-1.0, 0.5, 2.5], [0.0, 0.0, 6.0]])
    bodies = reset(poses)
    np.testing.assert_allclose(pose_of(bodies), poses, atol=1e-6)
    np.testing.assert_array_equal(estimate(bodies), poses)
    data = mujoco.MjData(MODEL)
    data.qpos = bodies.robot.qpos[1]
    before = data.qpos.copy()
    for _ in range(200):
        mujoco.mj_step(MODEL, data)
    np.testing.assert_allclose(data.qpos[:7], before[:7], atol=5e-4)


@pytest.mark.parametrize("side", [1, -1])
def test_the_turning_radius_is_that_of_the_steady_circle(side):
    measures = car_parameters(MODEL)
    bend = side / ROBOT.turning_radius
    angles = [atan(measures.wheelbase * bend / (1 - left * measures.half_track * bend)) for left in (1, -1)]
    assert max(np.abs(angles)) == pytest.approx(measures.max_angle)
    data = mujoco.MjData(MODEL)
    poses, time_step = [], MODEL.opt.timestep
    for _ in range(500):
        data.ctrl = [*angles, SETTINGS.speed / measures.full_speed]
        mujoco.mj_step(MODEL, data)
        poses.append(reference.pose_of(data))
    poses = np.array(poses[250:])
    speed = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).mean() / time_step
    turn = wrapped(np.diff(poses[:, 2])).mean() / time_step
    assert speed / turn == pytest.approx(side * ROBOT.turning_radius, rel=0.02)
    assert speed == pytest.approx(SETTINGS.speed, rel=0.05)


def test_a_lane_that_diverges_fails_alone(drives):
    (key, body, path, end, noise), before = drives[0]
    wrong = eqx.tree_at(lambda b: b.robot.qvel, body, body.robot.qvel.at[2, 0].set(jnp.nan))
    ride = follow(jax.random.clone(key), wrong, path, end, noise)
    others = np.arange(NUM_LANES) != 2
    np.testing.assert_array_equal(ride.failed, ~others)
    np.testing.assert_array_equal(np.asarray(ride.poses)[others], np.asarray(before.poses)[others])


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_problem_in_either_precision(dtype):
    problem = build(RobotParking(), dtype)

    def step(key):
        reset, drive = jax.random.split(key)
        world = problem.reset(reset)
        path = jnp.zeros((10, 3), dtype)
        return world, problem.execute(drive, world, path)

    world, (after, reading, events) = jax.eval_shape(step, jax.random.key(0))
    assert eqx.tree_equal(*(jax.tree.map(lambda x: (x.shape, x.dtype), tree) for tree in (world, after)))
    assert not any(leaf.weak_type for leaf in jax.tree.leaves((after, events)))
    assert reading.dtype == events.driven.dtype == after.reading.dtype == dtype
    assert after.robot.qpos.dtype == events.frames.dtype == jnp.float32
    assert events.frames.shape == (NUM_READINGS // FRAME_EVERY, MODEL.nq)


@pytest.mark.slow
def test_it_reaches_the_end_of_every_path_within_its_reach():
    @partial(jax.jit, compiler_options=REPEATABLY)
    def left(robot, length):
        """Of a path of this length and of one twice as long, in metres."""
        path = jnp.outer(jnp.linspace(0.0, length, 11)[1:], jnp.asarray([1.0, 0.0, 0.0]))
        paths = jnp.stack([path, 2.0 * path])
        ride = jax.vmap(
            lambda path: robot.follow(jax.random.key(0), robot.reset(jnp.zeros(3)), path, path[-1], None)
        )(paths)
        return paths[:, -1, 0] - ride.poses[:, -1, 0]

    for changes in ({}, {"speed": 0.3}, {"gain": 2.0}):
        robot = build(WheeledRobot(**changes))
        near, far = left(robot, jnp.asarray(robot.reach))
        assert abs(near) < 0.012, changes
        assert far > 0.1, changes


def test_paths_that_it_cannot_drive_are_refused_in_one_line(here, refusal):
    for setting, message in (
        ("length=1.3", r"\.length: got 1.3; allowed: <= 1.16, the longest path that the robot"),
        ("first_angle=1.4", ": the tightest trajectory has a radius of .*0.10 m"),
    ):
        assert re.search(f"planner.motions{message}", refusal(f"run robot-parking planner.motions.{setting}"))
