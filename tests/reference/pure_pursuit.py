"""A car that tracks a path by pure pursuit, in loops of NumPy and C MuJoCo."""

from math import atan, cos, pi, sin

import mujoco
import numpy as np

WHEELBASE, HALF_TRACK, FULL_SPEED, PIECES = 0.1, 0.04, 0.8, 8


def dense(start, path):
    """Points of the cubic curves through all poses, the start first."""
    points = [np.array(start[:2])]
    for before, after in zip([start, *path[:-1]], path, strict=True):
        chord = np.hypot(*(after[:2] - before[:2]))
        x = [_hermite(before[0], after[0], chord * cos(before[2]), chord * cos(after[2]), u) for u in STEPS]
        y = [_hermite(before[1], after[1], chord * sin(before[2]), chord * sin(after[2]), u) for u in STEPS]
        points += list(np.stack([x, y], axis=-1))
    return np.array(points)


STEPS = np.arange(1, PIECES + 1) / PIECES


def _hermite(a, b, slope_a, slope_b, u):
    """The cubic with these values and slopes at 0 and 1, as a polynomial in u."""
    return (
        a
        + slope_a * u
        + (3 * (b - a) - 2 * slope_a - slope_b) * u**2
        + (2 * (a - b) + slope_a + slope_b) * u**3
    )


def pose_of(data):
    """Position and heading of the chassis."""
    forward = data.body("chassis").xmat.reshape(3, 3)[:, 0]
    return np.array([data.qpos[0], data.qpos[1], np.arctan2(forward[1], forward[0]) % (2 * pi)])


def place(model, pose):
    """The car at rest at a pose."""
    data = mujoco.MjData(model)
    data.qpos[:2] = pose[:2]
    data.qpos[3:7] = cos(pose[2] / 2), 0, 0, sin(pose[2] / 2)
    mujoco.mj_kinematics(model, data)
    return data


def follow(model, data, start, path, errors, look_ahead, speed, gain, substeps, num_driven):
    """Poses at all readings, how many points of the curve were passed, all of `qpos`, and the last reading.

    The motor is off from reading `num_driven` on.
    """
    points = dense(start, path)
    arc = [0.0]
    for before, after in zip(points[:-1], points[1:], strict=True):
        arc.append(arc[-1] + np.hypot(*(after - before)))
    sharpest = 1 / (WHEELBASE / np.tan(model.actuator_ctrlrange[0, 1]) + HALF_TRACK)
    reading, passed = np.array(start), 0
    poses, passes, places = [], [], [data.qpos.copy()]
    for number, error in enumerate(errors):
        poses.append(pose_of(data))
        ahead = range(passed, len(arc))
        window = [i for i in ahead if i == passed + 1 or arc[i] <= arc[passed] + look_ahead]
        passed = min(window, key=lambda i: np.hypot(*(points[i] - reading[:2])))
        passes.append(passed)
        left = arc[-1] - arc[passed]
        if left >= look_ahead:
            goal = [np.interp(arc[passed] + look_ahead, arc, points[:, axis]) for axis in (0, 1)]
        else:
            goal = points[-1] + (look_ahead - left) * np.array([cos(path[-1][2]), sin(path[-1][2])])
        away = np.hypot(*(goal - reading[:2]))
        bearing = np.arctan2(goal[1] - reading[1], goal[0] - reading[0]) - reading[2]
        bend = np.clip(2 * sin(bearing) / away, -sharpest, sharpest)
        # Each wheel stands across the line from it to the centre of the turn.
        angles = [atan(WHEELBASE * bend / (1 - side * HALF_TRACK * bend)) for side in (1, -1)]
        data.ctrl = [*angles, min(speed, gain * left) / FULL_SPEED if number < num_driven else 0]
        for _ in range(substeps):
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        reading = pose_of(data) + error
        places.append(data.qpos.copy())
    return np.array([*poses, pose_of(data)]), np.array(passes), np.array(places), reading


def at_poses(poses, passes, num_poses):
    """The poses when each pose of the path was first passed; the last one at the end."""
    chosen = []
    for number in range(1, num_poses + 1):
        later = [step for step, passed in enumerate(passes) if passed >= number * PIECES]
        chosen.append(poses[later[0] if later and number < num_poses else len(poses) - 1])
    return np.array(chosen)
