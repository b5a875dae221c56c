"""The way through poses against calculus, and the controller against C MuJoCo."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.motions.splines import SplineSet
from bojax.problems.vehicles.settings import Quadrotor
from bojax.robots.flight import Reference, control, reference_trajectory
from bojax.robots.models import packaged
from bojax.robots.quaternions import rotate_yaw, rotation_matrix, yaw_of
from tests.arrays import f64

STEP, PATH, REST = 0.01, 300, 250
ALTITUDE = 1.2


def f32(value):
    return jnp.asarray(value, jnp.float32)


@functools.cache
def airframe():
    return build(Quadrotor(), "float32").airframe


@jax.jit
def steer(airframe, reference, qpos, qvel):
    return control(airframe, reference, qpos[:3], qvel[:3], rotation_matrix(qpos[3:]), qvel[3:])


def fly(reference, qpos, qvel=(0.0,) * 6, push=None):
    """Positions and velocities before every step of C MuJoCo; `push` is a force in N over some steps."""
    model = packaged("quadrotor").compiled()
    data = mujoco.MjData(model)
    data.qpos, data.qvel = qpos, qvel
    states = []
    for index in range(len(reference.yaw)):
        states.append((data.qpos.copy(), data.qvel.copy()))
        now = jax.tree.map(lambda part: part[index], reference)  # noqa: B023
        data.ctrl = steer(airframe(), now, f32(data.qpos), f32(data.qvel))
        data.xfrc_applied[1, :3] = 0.0 if push is None or index not in push[1] else push[0]
        mujoco.mj_step(model, data)
    return tuple(np.array(part) for part in zip(*states, strict=True))


def hovering(number, yaw=0.0):
    zero = np.zeros((number, 3), np.float32)
    return Reference(
        zero + np.float32([0.0, 0.0, ALTITUDE]), zero, zero, zero[:, 0] + np.float32(yaw), *2 * [zero[:, 0]]
    )


def at(x, y, yaw=0.0):
    return np.array([x, y, ALTITUDE, np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)])


@jax.jit
def plan(start, path, end_heading):
    return reference_trajectory(
        start, path, end_heading, jnp.full_like(end_heading, ALTITUDE), STEP, PATH, REST
    )


START = np.array([0.3, -0.2, 2.9])


@functools.cache
def spline(action):
    """A planned path of a metre from `START`, in the world's frame."""
    path = np.asarray(jax.jit(SplineSet.paths)(SplineSet(f64(1.0), 5, 8)))[action]
    cos, sin = np.cos(START[2]), np.sin(START[2])
    turn = np.array([[cos, sin], [-sin, cos]])
    return np.column_stack([path[:, :2] @ turn + START[:2], path[:, 2] + START[2]])


each_path = pytest.mark.parametrize("action", (0, 1, 4))


@each_path
def test_a_way_goes_through_the_poses_from_rest_to_rest(action):
    path = spline(action)
    reference, steps = jax.tree.map(np.asarray, plan(f64(START), f64(path), f64(path[-1, 2] + np.pi)))
    np.testing.assert_allclose(reference.position[0], [*START[:2], ALTITUDE])
    np.testing.assert_array_equal(reference.position[:, 2], ALTITUDE)
    # A pose is passed at the first step at or after it: less than one step's way off.
    speed = np.linalg.norm(reference.velocity, axis=1)
    gap = np.linalg.norm(reference.position[steps, :2] - path[:, :2], axis=1)
    assert np.all(gap <= 1.05 * STEP * speed.max()) and gap[-1] < 1e-4
    assert np.all(np.diff(steps) > 0) and steps[-1] <= PATH
    heading = np.exp(1j * reference.yaw)
    assert np.abs(heading[steps] - np.exp(1j * path[:, 2])).max() < 0.03
    assert heading[-1] == pytest.approx(np.exp(1j * (path[-1, 2] + np.pi)), abs=1e-3)
    assert speed[0] == 0.0 and np.all(speed[PATH:] < 1e-12)
    assert np.all(reference.yaw_rate[[0, PATH]] == 0.0)
    # It looks ahead: the velocity is along the heading while it flies.
    along = reference.velocity[30:-REST:30, 0] + 1j * reference.velocity[30:-REST:30, 1]
    assert np.abs(np.angle(along / heading[30:-REST:30])).max() < 0.05


@each_path
def test_velocities_and_accelerations_are_derivatives(action):
    path = spline(action)
    reference, _ = jax.tree.map(np.asarray, plan(f64(START), f64(path), f64(path[-1, 2] + 2.0)))
    for value, rate, tolerance in [
        (reference.position, reference.velocity, 0.01),
        (reference.velocity, reference.acceleration, 0.25),
        (reference.yaw, reference.yaw_rate, 0.25),
    ]:
        slope = (value[2:] - value[:-2]) / (2 * STEP)
        # The curvature jumps a little at the poses.
        assert np.abs(slope - rate[1:-1]).max() < tolerance
        assert np.abs(slope - rate[1:-1]).mean() < 0.1 * tolerance
    rate = reference.yaw_rate[PATH:]
    slope = (rate[2:] - rate[:-2]) / (2 * STEP)
    np.testing.assert_allclose(slope, reference.yaw_acceleration[PATH + 1 : -1], atol=2e-3)


def test_a_robot_that_is_stopped_stays_there():
    path = np.repeat(spline(1)[2:3], 8, axis=0)
    path[:2] = spline(1)[:2]
    reference, steps = jax.tree.map(np.asarray, plan(f64(START), f64(path), f64(path[-1, 2] + np.pi)))
    np.testing.assert_allclose(reference.position[PATH:, :2], path[2:3, :2].repeat(REST, 0), atol=1e-9)
    assert np.all(steps[2:] == steps[2]) and steps[0] < steps[1] < steps[2] <= PATH
    assert np.all(np.isfinite(np.concatenate([part.ravel() for part in jax.tree.leaves(reference)])))

    blocked = np.repeat(START[None], 8, axis=0)
    reference, steps = jax.tree.map(np.asarray, plan(f64(START), f64(blocked), f64(START[2] + np.pi)))
    np.testing.assert_allclose(reference.position[:, :2], blocked[:1, :2].repeat(PATH + REST, 0), atol=1e-9)
    np.testing.assert_array_equal(steps, PATH)
    assert np.exp(1j * reference.yaw[-1]) == pytest.approx(-np.exp(1j * START[2]), abs=1e-3)


def test_rotations_are_mujocos():
    rng = np.random.default_rng(0)
    for _ in range(20):
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        matrix, product = np.zeros(9), np.zeros(4)
        mujoco.mju_quat2Mat(matrix, quaternion)
        np.testing.assert_allclose(rotation_matrix(f64(quaternion)), matrix.reshape(3, 3), atol=1e-12)
        yaw = rng.uniform(-3.0, 3.0)
        mujoco.mju_mulQuat(product, np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]), quaternion)
        np.testing.assert_allclose(rotate_yaw(f64(quaternion), f64(yaw)), product, atol=1e-12)
        assert yaw_of(f64(quaternion)) == pytest.approx(np.arctan2(matrix[3], matrix[0]), abs=1e-12)


def test_thrusts_make_the_force_and_torque_that_are_asked_for():
    model = packaged("quadrotor").compiled()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(10):
        thrust, torque = rng.uniform(10.0, 20.0), rng.uniform(-1.0, 1.0, 3) * [0.3, 0.3, 0.05]
        data.ctrl = airframe().thrusts(f32(thrust), f32(torque))
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_actuator, [0.0, 0.0, thrust, *torque], atol=1e-4)
    assert np.all(airframe().thrusts(f32(100.0), f32([0.0, 0.0, 0.0])) == 13.0)
    assert np.all(airframe().thrusts(f32(-1.0), f32([0.0, 0.0, 0.0])) == 0.0)


def test_hovering_takes_the_weight():
    reference = jax.tree.map(lambda part: part[0], hovering(1, 0.7))
    thrusts = steer(airframe(), reference, f32(at(0.0, 0.0, 0.7)), jnp.zeros(6, jnp.float32))
    np.testing.assert_allclose(thrusts, 1.325 * 9.81 / 4, rtol=1e-5)


def test_a_figure_eight_is_flown_within_a_decimetre():
    """Two circles' worth of 1 m in 8 s."""
    t = STEP * np.arange(800)
    w = 2 * np.pi / 8.0
    zero = 0.0 * t
    position = np.stack([np.sin(w * t), 0.5 * np.sin(2 * w * t), zero + ALTITUDE], axis=1)
    velocity = np.stack([w * np.cos(w * t), w * np.cos(2 * w * t), zero], axis=1)
    acceleration = np.stack([-w * w * np.sin(w * t), -2 * w * w * np.sin(2 * w * t), zero], axis=1)
    parts = (part.astype(np.float32) for part in (position, velocity, acceleration, zero, zero, zero))
    qpos, _ = fly(Reference(*parts), at(0.0, 0.0), np.array([w, w, 0.0, 0.0, 0.0, 0.0]))
    error = np.linalg.norm(qpos[:, :3] - position, axis=1)
    assert error.max() < 0.1 and error[400:].max() < 0.05


def test_it_comes_back_after_a_push():
    qpos, qvel = fly(hovering(500), at(0.0, 0.0), push=(np.array([6.0, -4.0, 3.0]), range(50, 80)))
    off = np.linalg.norm(qpos[:, :3] - [0.0, 0.0, ALTITUDE], axis=1)
    assert off[:50].max() < 1e-3 and off.max() > 0.1
    assert off[-1] < 0.01 and np.abs(qvel[-1]).max() < 0.02


def test_it_rights_itself():
    """From a lean of 60 degrees and a heading that is wrong by a right angle."""
    lean = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0, 0.0])
    qpos, qvel = fly(hovering(500, np.pi / 2), np.array([0.0, 0.0, ALTITUDE, *lean]))
    assert np.linalg.norm(qpos[-1, :3] - [0.0, 0.0, ALTITUDE]) < 0.02
    assert float(yaw_of(f64(qpos[-1, 3:]))) == pytest.approx(np.pi / 2, abs=0.02)
    assert np.abs(qvel[-1]).max() < 0.05


def test_a_planned_path_is_flown_and_the_turn_made():
    path = spline(4)
    reference, steps = plan(f32(START), f32(path), f32(path[-1, 2] + np.pi))
    qpos, qvel = fly(jax.tree.map(np.asarray, reference), at(*START))
    assert np.linalg.norm(qpos[np.asarray(steps), :2] - path[:, :2], axis=1).max() < 0.03
    assert np.abs(qpos[:, 2] - ALTITUDE).max() < 0.01
    assert np.exp(1j * float(yaw_of(f64(qpos[-1, 3:])))) == pytest.approx(-np.exp(1j * path[-1, 2]), abs=0.02)
    assert np.abs(qvel[-1]).max() < 0.05


def test_without_feed_forward_it_lags():
    """The test above would not tell a controller that ignores the acceleration."""
    path = spline(4)
    reference, _ = plan(f32(START), f32(path), f32(path[-1, 2]))
    reference = jax.tree.map(np.asarray, reference)
    blind = Reference(**{**vars(reference), "acceleration": 0.0 * reference.acceleration})
    errors = [
        np.linalg.norm(fly(part, at(*START))[0][:, :2] - reference.position[:, :2], axis=1).max()
        for part in (reference, blind)
    ]
    assert errors[0] < 0.5 * errors[1]
