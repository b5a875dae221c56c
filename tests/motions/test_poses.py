"""Poses as columns, for kernels."""

import numpy as np
import pytest

from bojax.motions.base import Poses, place, placed


def test_poses_in_columns_are_indexed_like_an_array():
    path, pose = np.random.default_rng(0).normal(size=(4, 3)), np.array([1.0, -2.0, 0.5])
    poses = Poses(list(path.T), Poses(list(path[-1])))
    assert poses.shape == path.shape and [poses[-1][i] for i in range(3)] == list(path[-1])
    moved = np.stack(placed(poses, pose), axis=-1)
    np.testing.assert_allclose(moved, place(path, pose), atol=1e-12)


@pytest.mark.parametrize("index", [0, 3, (-1, 0), (slice(1, None), 0), slice(None)])
def test_an_index_that_a_kernel_lacks_is_refused(index):
    poses = Poses([np.zeros(4)] * 3, Poses([0.0, 0.0, 0.0]))
    with pytest.raises(IndexError, match=r"allowed in a kernel: poses\[\.\.\., i\] and poses\[-1\]"):
        poses[index]
