"""Acquisition functions, fields, kernels, prior means, schedules and families of trajectories."""

import jax
import jax.numpy as jnp
import pytest

from bojax.engine.build import build
from bojax.motions.base import ContinuousMotions
from tests.parts import tiny
from tests.protocol.lanes import each_kind, of_one

pytestmark = pytest.mark.usefixtures("data_files")

POINTS = jnp.asarray([[0.2, 0.3], [0.7, 0.4], [0.5, 0.9]])


@each_kind("acquisition")
def test_an_acquisition_function_scores_points(kind, check):
    mean, std, best = jnp.asarray([-1.0, 0.0, 0.5]), jnp.asarray([0.1, 1.0, 0.5]), jnp.asarray(0.4)
    check(build(tiny("acquisition", kind)), of_one(lambda part, _, xs: part(*xs)), (mean, std, best))


@each_kind("field")
def test_a_field_has_values_and_gradients(kind, check):
    check(build(tiny("field", kind)), of_one(lambda part, _, x: (part.values(x), part.gradients(x))), POINTS)


@each_kind("kernel")
def test_a_kernel_is_a_covariance_of_points(kind, check):
    check(build(tiny("kernel", kind)), of_one(lambda part, _, x: part.gram(x, x)), POINTS)


@each_kind("mean")
def test_a_prior_mean_has_a_value_at_every_point(kind, check):
    part = build(tiny("mean", kind))
    part = jax.tree.map(lambda leaf: leaf + 1.0, part)  # the defaults are zero, at any scale
    check(part, of_one(lambda part, _, x: jax.vmap(part)(x)), POINTS)


@each_kind("schedule")
def test_a_schedule_has_an_exploration_state_for_every_episode(kind, check):
    def states(part, _, episodes):
        lasting = jax.vmap(lambda episode: part(episode, jnp.asarray(False)))(episodes)
        reached = jax.vmap(lambda episode: part(episode, jnp.asarray(True)))(episodes)
        return lasting, reached

    check(build(tiny("schedule", kind)), of_one(states), jnp.arange(60, dtype=jnp.int32))


@each_kind("motions")
def test_a_family_of_trajectories_has_paths(kind, check):
    part = build(tiny("motions", kind))
    size = part.num_params if isinstance(part, ContinuousMotions) else part.num_actions
    assert size >= 1

    def sample(part, key, _):
        path = part.sample(key)
        assert path.shape == (part.num_samples, 3)
        return path

    check(part, of_one(sample))
