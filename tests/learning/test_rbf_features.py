"""Normalised radial basis functions: their formula in NumPy, their bilinear form, and their limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.envs.spaces import Box, Discrete
from bojax.learning.settings import NormalisedRBF

OBSERVATIONS = Box(jnp.asarray([-1.0, -2.0]), jnp.asarray([1.0, 2.0]))
ACTIONS = Box(jnp.asarray([-3.0]), jnp.asarray([3.0]))


def drawn(observations=OBSERVATIONS, actions=ACTIONS, **settings):
    spec = build(NormalisedRBF(num_state_centres=12, num_action_centres=3, **settings))
    return eqx.filter_jit(spec.draw)(jax.random.key(0), observations, actions, jnp.dtype(jnp.float64))


def normalised(unit, centres, width):
    functions = np.exp(-((np.clip(unit, 0, 1) - centres) ** 2).sum(axis=1) / (2 * width**2))
    return functions / np.linalg.norm(functions)


@pytest.mark.parametrize("width", [0.5, 2.0])
def test_features_are_those_of_the_formula(width):
    features = drawn(width=width)
    s, a = np.asarray([0.3, -2.5]), np.asarray([1.7])  # the second observation is outside its bounds
    x = normalised((s + [1, 2]) / [2, 4], np.asarray(features.state_centres), width * 12 ** (-1 / 2))
    y = normalised((a + 3) / 6, np.asarray(features.action_centres), width / 3)
    phi = np.asarray(eqx.filter_jit(features)(s, a))
    np.testing.assert_allclose(phi, np.outer(x, y).ravel(), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(phi), 1.0)


def test_a_value_far_from_all_centres_is_that_at_the_border():
    features, a = drawn(width=0.05), jnp.asarray([0.0])
    inside, outside = features(jnp.asarray([1.0, 2.0]), a), features(jnp.asarray([9.0, 30.0]), a)
    np.testing.assert_array_equal(inside, outside)
    assert np.isfinite(inside).all()


def test_discrete_actions_have_a_feature_each():
    features = drawn(actions=Discrete(4))
    assert features.num_features == 48
    np.testing.assert_array_equal(features.action(jnp.int32(2)), [0, 0, 1, 0])
