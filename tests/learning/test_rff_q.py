"""RFF-Q acts epsilon-greedily, on a finite set and on draws from a box; random actions are uniform."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.engine.build import build
from bojax.envs.spaces import Box, Discrete
from bojax.learning.settings import RFFQ, OneHot, RandomActions, RandomFourierFeatures
from tests.learning.probes import exploring

DRAWS = 4000


@eqx.filter_jit
def acted(learner, state, observation):
    """Actions under many keys, the returns expected of them, and their Q."""
    keys = jax.random.split(jax.random.key(1), DRAWS)
    action, expected = jax.vmap(lambda key: learner.act(key, state, observation, exploring()))(keys)
    return action, expected, jax.vmap(lambda a: learner.values(state, observation, a)[0])(action)


@pytest.mark.parametrize("epsilon", [0.0, 0.4, 1.0])
def test_of_a_finite_set_the_best_actions_and_all_others_are_equally_likely(epsilon):
    learner = build(RFFQ(features=OneHot(), epsilon=epsilon), "float64")
    state = eqx.filter_jit(learner.init)(jax.random.key(0), Discrete(2), Discrete(5), 0)
    q = np.asarray([0.0, 1.0, -1.0, 1.0, 0.5])
    state = eqx.tree_at(lambda s: s.weights, state, jnp.concatenate([-q, q]))
    action, expected, _ = acted(learner, state, jnp.ones((), jnp.int32))
    np.testing.assert_array_equal(expected, q[action])
    shares = np.full(5, epsilon / 5) + (1.0 - epsilon) * np.asarray([0.0, 0.5, 0.0, 0.5, 0.0])
    counts = np.bincount(action, minlength=5)
    assert not counts[shares == 0.0].any()
    assert stats.chisquare(counts[shares > 0.0], DRAWS * shares[shares > 0.0]).pvalue > 1e-3


def test_in_a_box_a_random_action_is_uniform_and_the_best_of_several_draws_is_not():
    space = Box(jnp.asarray([-1.0]), jnp.asarray([3.0]))

    learner = build(
        RFFQ(num_actions=4, initial_weight=1.0, features=RandomFourierFeatures(num_features=20)), "float64"
    )
    state = eqx.filter_jit(learner.init)(jax.random.key(0), space, space, 0)

    def actions(epsilon):
        changed = eqx.tree_at(lambda learner: learner.epsilon, learner, jnp.asarray(epsilon))
        action, expected, found = acted(changed, state, jnp.zeros(1))
        np.testing.assert_allclose(expected, found, atol=1e-12)
        return np.asarray(action)[:, 0], np.asarray(expected)

    at_random, values = actions(1.0)
    assert stats.kstest(at_random, "uniform", args=(-1.0, 4.0)).pvalue > 1e-3
    _, best = actions(0.0)
    # The best of four independent draws is below a value with the fourth power of the probability of one.
    levels = np.quantile(values, [0.5, 0.7, 0.9])
    shares = np.mean(best[:, None] <= levels[None, :], axis=0)
    np.testing.assert_allclose(shares, np.asarray([0.5, 0.7, 0.9]) ** 4, atol=0.03)


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_actions_are_uniform(scale):
    exploration = exploring(scale, is_learning=False)
    learner = build(RandomActions())

    def drawn(space):
        state = learner.init(jax.random.key(1), Discrete(3), space, capacity=10)
        act = jax.jit(jax.vmap(lambda key: learner.act(key, state, jnp.int32(0), exploration)[0]))
        return np.asarray(act(jax.random.split(jax.random.key(0), 2000)))

    box = drawn(Box(jnp.asarray([-1.0, 2.0]), jnp.asarray([1.0, 6.0])))
    for column, (low, width) in zip(box.T, [(-1.0, 2.0), (2.0, 4.0)], strict=True):
        assert stats.kstest(column, stats.uniform(low, width).cdf).pvalue > 1e-3
    assert stats.chisquare(np.bincount(drawn(Discrete(4)), minlength=4)).pvalue > 1e-3
