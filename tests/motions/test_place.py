"""Placing a path is a rigid motion: where the robot stands changes nothing about its path."""

import jax.numpy as jnp
import numpy as np
import pytest

from bojax.motions.base import place
from tests.motions.families import FAMILIES, all_paths, wrapped

POSES = [[0.0, 0.0, 0.0], [3.0, -2.0, 0.0], [-1.5, 0.5, 2.0], [100.0, 50.0, -9.0]]
each_pose = pytest.mark.parametrize("pose", POSES)


def paths_from(name: str, pose) -> tuple[np.ndarray, np.ndarray]:
    paths = all_paths(FAMILIES[name])
    return paths, np.asarray(place(jnp.asarray(paths), jnp.asarray(pose)))


@each_pose
@pytest.mark.parametrize("name", FAMILIES)
def test_distances_and_turns_are_kept(name, pose):
    own, placed = paths_from(name, pose)

    def distances(paths):
        apart = paths[:, :, None, :2] - paths[:, None, :, :2]
        return np.linalg.norm(apart, axis=-1)

    np.testing.assert_allclose(distances(placed), distances(own), atol=1e-12)
    np.testing.assert_allclose(np.diff(placed[..., 2], axis=1), np.diff(own[..., 2], axis=1), atol=1e-12)


@each_pose
def test_seen_from_the_robot_the_path_is_the_same(pose):
    own, placed = paths_from("kernel", pose)
    offset = placed[..., :2] - np.asarray(pose[:2])
    distance, bearing = np.linalg.norm(offset, axis=-1), np.arctan2(offset[..., 1], offset[..., 0])
    np.testing.assert_allclose(distance, np.linalg.norm(own[..., :2], axis=-1), atol=1e-12)
    expected = np.arctan2(own[..., 1], own[..., 0])
    np.testing.assert_allclose(wrapped(bearing - pose[2] - expected), 0.0, atol=1e-11)
    np.testing.assert_allclose(placed[..., 2] - pose[2], own[..., 2], atol=1e-12)


@pytest.mark.parametrize("outer", POSES)
def test_placing_twice_is_placing_once_at_the_composed_pose(outer):
    paths, outer = jnp.asarray(all_paths(FAMILIES["kernel"])), jnp.asarray(outer)
    for inner in map(jnp.asarray, POSES):
        composed = place(inner[None], outer)[0]
        np.testing.assert_allclose(place(place(paths, inner), outer), place(paths, composed), atol=1e-12)
