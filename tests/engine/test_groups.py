"""Static groups: which points share a program, and which leaves get a batch axis."""

import jax
import numpy as np
import pytest

import bojax
from bojax.config.sweep import load_sweep
from bojax.engine.groups import static_groups
from bojax.engine.plan import make_plan
from tests.toy import toy


def test_points_with_equal_statics_share_a_group():
    modules = [toy(scale=1.0), toy(max_length=15), toy(scale=2.0), toy(max_length=15, poison=3.0)]
    assert [group.points for group in static_groups(modules)] == [(0, 2), (1, 3)]


def test_what_is_learned_when_is_a_number_of_a_lane():
    """Whether tests explore, starts are shared, or learning goes on after the target."""
    settings = {"env": "chain", "learner": "epsilon-greedy", "tests": 1, "target_return": 1.0}
    runs = [
        bojax.part(
            "learning",
            **settings,
            tests_learn=tests_learn,
            starts=starts,
            schedule={"kind": "until-target", "learns_after": learns_after},
        )
        for tests_learn in ("no", "exploiting", "exploring")
        for starts in ("per-episode", "per-run")
        for learns_after in (False, True)
    ]
    assert [len(group.points) for group in static_groups(runs)] == [4, 8]


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


@pytest.mark.parametrize(
    ("sweep", "sizes"),
    [
        ("fig-4.4", [2, 2, 4, 1]),  # kCBTS and its copies, GPS-ABT, SBO with any number of actions, random
        ("fig-4.6", [3, 4, 2, 1]),
        ("table-4.1-times", [1, 3, 1, 3]),
        ("table-5.3-mountain-car", [1, 2, 2, 1, 1, 1]),  # RFF-Q with both rewards, DORA with both policies
        ("fig-5.6b", [10, 10]),  # chains of any length
    ],
)
def test_settings_of_shipped_sweeps_share_programs(sweep, sizes):
    plan = make_plan(load_sweep(sweep), jax.devices()[:1])
    assert [len(group.points) for group in plan.groups] == sizes
