"""Static groups: which points share a program, and which leaves get a batch axis."""

import jax
import numpy as np

from bojax.engine.groups import static_groups
from tests.toy import toy


def test_points_with_equal_statics_share_a_group():
    modules = [toy(scale=1.0), toy(max_length=15), toy(scale=2.0), toy(max_length=15, poison=3.0)]
    assert [group.points for group in static_groups(modules)] == [(0, 2), (1, 3)]


def test_a_dtype_is_static():
    single = jax.tree.map(lambda leaf: leaf.astype("float32"), toy())
    assert [group.points for group in static_groups([toy(), single])] == [(0,), (1,)]


def test_only_leaves_that_differ_are_swept():
    (group,) = static_groups([toy(scale=1.0), toy(scale=2.0), toy(scale=2.0, start=(1.0, 0.0))])
    assert group.swept.scale.tolist() == [1.0, 2.0, 2.0]
    assert group.swept.start.shape == (3, 2)
    assert group.swept.poison is None and group.shared.poison == 1e9
    assert group.shared.scale is None and group.shared.start is None


def test_a_single_point_sweeps_nothing():
    (group,) = static_groups([toy()])
    assert jax.tree.leaves(group.swept) == []


def test_the_module_of_a_lane():
    modules = [toy(scale=1.0), toy(scale=2.0, start=(1.0, 0.0))]
    (group,) = static_groups(modules)
    swept = group.swept_at(np.array([1, 0, 1]))
    module = group.experiment(jax.tree.map(lambda leaf: leaf[0], swept), group.shared)
    assert jax.tree.all(jax.tree.map(np.array_equal, module, modules[1]))
