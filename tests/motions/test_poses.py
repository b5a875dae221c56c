"""Poses as columns, for kernels."""

import jax.numpy as jnp
import numpy as np
import pytest

from bojax.motions.base import Poses, place, placed


def columns(array):
    return [jnp.asarray(array[..., i]) for i in range(3)]


def test_poses_in_columns_are_indexed_like_an_array():
    rng = np.random.default_rng(0)
    path, pose = jnp.asarray(rng.normal(size=(4, 3))), jnp.asarray([1.0, -2.0, 0.5])
    poses = Poses(columns(path), Poses(columns(path[-1])))
    assert poses.shape == path.shape and [float(poses[-1][i]) for i in range(3)] == path[-1].tolist()
    moved = jnp.stack(placed(poses, pose), axis=-1)
    np.testing.assert_allclose(moved, place(path, pose), atol=1e-12)


@pytest.mark.parametrize("index", [0, 3, (-1, 0), (slice(1, None), 0), slice(None)])
def test_an_index_that_a_kernel_lacks_is_refused(index):
    poses = Poses(columns(np.zeros((4, 3))), Poses(columns(np.zeros(3))))
    with pytest.raises(IndexError, match=r"allowed in a kernel: poses\[\.\.\., i\] and poses\[-1\]"):
        poses[index]
