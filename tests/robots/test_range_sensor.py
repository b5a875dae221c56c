"""Rays against closed forms, and against those of C MuJoCo on a height field and on blocks."""

import jax
import mujoco
import numpy as np
import pytest

from bojax.fields.closed_form import Blocks, Bumps
from bojax.films.robot_worlds import quadrotor_world
from bojax.results.outline import Outline
from bojax.robots.range_sensor import cone, ranges
from tests.arrays import f64

MAX_RANGE = 4.0
DOMAIN = (0.0, 0.0, 3.0, 3.0)
HILLS = {
    "heights": [0.8, 0.5],
    "centres": [[1.0, 1.8], [2.2, 0.9]],
    "widths": [0.5, 0.4],
}
PROPS = {"boxes": [[0.4, 0.5, 1.0, 1.2], [1.6, 1.4, 2.5, 2.4]], "heights": [0.4, 0.9]}
PROP_WORLD = Outline(
    border=DOMAIN,
    blocks=[(*box, height) for box, height in zip(PROPS["boxes"], PROPS["heights"], strict=True)],
)


def rotations(num, lean, seed=0):
    """Attitudes that lean by up to so many radians, as rotation matrices."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(num):
        yaw, angle, about = rng.uniform(0, 2 * np.pi), rng.uniform(0, lean), rng.uniform(0, 2 * np.pi)
        parts = []
        for axis, turn in (([0.0, 0.0, 1.0], yaw), ([np.cos(about), np.sin(about), 0.0], angle)):
            quaternion, matrix = np.zeros(4), np.zeros(9)
            mujoco.mju_axisAngle2Quat(quaternion, np.array(axis), turn)
            mujoco.mju_quat2Mat(matrix, quaternion)
            parts.append(matrix.reshape(3, 3))
        found.append(parts[1] @ parts[0])
    return np.array(found)


def origins(num, seed=1):
    return np.random.default_rng(seed).uniform([0.4, 0.4, 1.3], [2.6, 2.6, 2.0], (num, 3))


@jax.jit
def measure(field, origin, rotation, rays):
    def one(origin, rotation):
        return ranges(field.values, origin, rotation, rays, f64(MAX_RANGE))

    return jax.vmap(one)(origin, rotation)


def mujoco_ranges(model, origin, rotation, rays):
    model = model.compiled()
    data = mujoco.MjData(model)
    data.qpos[:3] = 50.0  # out of the way
    mujoco.mj_forward(model, data)
    hit = np.zeros(1, np.int32)
    cast = lambda start, way: mujoco.mj_ray(model, data, start, way, None, 1, -1, hit)  # noqa: E731
    return np.array(
        [[cast(o, r @ ray) for ray in np.asarray(rays)] for o, r in zip(origin, rotation, strict=True)]
    )


def test_a_cone_is_filled_evenly():
    rays = np.asarray(cone(f64(0.2), 200))
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
    angle = np.arccos(-rays[:, 2])
    np.testing.assert_allclose(rays[0], [0.0, 0.0, -1.0], atol=1e-15)
    assert angle.max() == pytest.approx(0.1) and angle[-1] == angle.max()
    # Evenly: half of the rays lie in half of the solid angle, and they lean no way.
    assert np.mean(angle < 0.1 / 2**0.5) == pytest.approx(0.5, abs=0.02)
    assert np.abs(rays[:, :2].mean(axis=0)).max() < 0.002
    np.testing.assert_allclose(cone(f64(0.2), 1), [[0.0, 0.0, -1.0]], atol=1e-15)


def test_over_a_plane_it_is_the_altitude_over_the_cosine():
    flat = Bumps(f64([0.0]), f64([[0.0, 0.0]]), f64([1.0]))
    origin, rotation, rays = origins(50), rotations(50, 0.5), cone(f64(0.3), 5)
    found = measure(flat, f64(origin), f64(rotation), rays)
    drop = -np.einsum("nij,kj->nki", rotation, np.asarray(rays))[..., 2]
    np.testing.assert_allclose(found, origin[:, 2:] / drop, atol=1e-6)


def test_what_is_too_far_reads_as_the_range_and_what_is_inside_as_nothing():
    flat = Bumps(f64([0.0]), f64([[0.0, 0.0]]), f64([1.0]))
    upright = np.eye(3)[None].repeat(3, 0)
    high = np.array([[0.0, 0.0, MAX_RANGE + 0.01], [0.0, 0.0, MAX_RANGE - 0.01], [0.0, 0.0, -0.1]])
    found = measure(flat, f64(high), f64(upright), cone(f64(0.0), 1))[:, 0]
    np.testing.assert_allclose(found, [MAX_RANGE, MAX_RANGE - 0.01, 0.0], atol=1e-6)


@pytest.mark.parametrize("lean", [0.0, 0.6])
def test_blocks_are_seen_as_mujoco_sees_boxes(lean):
    blocks = Blocks(f64(PROPS["boxes"]), f64(PROPS["heights"]))
    model = quadrotor_world(PROP_WORLD)
    origin, rotation, rays = origins(300), rotations(300, lean), cone(f64(0.1), 3)
    found = np.asarray(measure(blocks, f64(origin), f64(rotation), rays))
    expected = mujoco_ranges(model, origin, rotation, rays)
    seen = expected > 0.0  # the floor ends at the domain
    # The march may pass a corner that a ray only just cuts.
    is_same = np.abs(found - expected)[seen] < 1e-6
    assert np.mean(is_same) > 0.99
    assert np.all(found[seen][~is_same] > expected[seen][~is_same])
    heights = (origin[:, 2:] - found)[seen]
    assert lean > 0 or {0.0, 0.4, 0.9} <= set(np.round(heights, 6))


def test_hills_are_seen_as_mujoco_sees_a_height_field():
    hills = Bumps(*(f64(HILLS[name]) for name in ("heights", "centres", "widths")))
    axis = np.linspace(0.0, 3.0, 201)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    model = quadrotor_world(Outline(border=DOMAIN), np.asarray(hills.values(f64(grid))).reshape(201, 201))
    origin, rotation, rays = origins(200), rotations(200, 0.4), cone(f64(0.1), 3)
    found = np.asarray(measure(hills, f64(origin), f64(rotation), rays))
    expected = mujoco_ranges(model, origin, rotation, rays)
    seen = expected > 0.0
    assert seen.mean() > 0.9
    # A triangle of 1.5 cm departs from a curvature of 0.8 / 0.5^2 per metre by 0.1 mm.
    np.testing.assert_allclose(found[seen], expected[seen], atol=3e-4)


def test_any_recorded_field_but_blocks_is_a_height_field():
    x, y = np.linspace(0.0, 3.0, 4), np.linspace(0.0, 3.0, 7)
    model = quadrotor_world(Outline(border=DOMAIN), 0.1 * x[None] + 0.2 * y[:, None])
    origin, rays = origins(100), cone(f64(0.0), 1)
    found = mujoco_ranges(model, origin, np.eye(3)[None].repeat(100, 0), rays)[:, 0]
    np.testing.assert_allclose(found, origin @ [-0.1, -0.2, 1.0], atol=1e-5)


def test_blocks_stay_boxes_and_without_values_there_is_a_floor():
    assert quadrotor_world(PROP_WORLD, np.ones((5, 5))).xml == quadrotor_world(PROP_WORLD).xml
    flat = quadrotor_world(Outline(border=DOMAIN))
    found = mujoco_ranges(flat, origins(5), np.eye(3)[None].repeat(5, 0), cone(f64(0.0), 1))[:, 0]
    np.testing.assert_allclose(found, origins(5)[:, 2])
