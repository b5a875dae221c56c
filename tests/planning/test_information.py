"""Rewards on information: the entropy that an action takes from a belief of particles."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.planning.leaf_values import ParticleSet, StateValue
from bojax.planning.pft import ENTROPY_FLOOR, BeliefStep, entropy
from bojax.planning.tree import ROOT
from tests.planning.belief_searches import belief_of, drift, number, planner, search


def gaussian_entropy(weights, states):
    """Half the log determinant of the covariance in NumPy."""
    covariance = np.cov(states.T, aweights=weights, ddof=0)
    return 0.5 * np.linalg.slogdet(covariance + ENTROPY_FLOOR * np.eye(states.shape[1]))[1]


def test_the_entropy_is_that_of_a_gaussian():
    rng = np.random.default_rng(0)
    states, weights = rng.normal(size=(50, 3)) * [1.0, 0.1, 5.0], rng.uniform(size=50)
    weights[:10] = 0.0
    found = jax.jit(entropy)(jnp.log(jnp.asarray(weights)), jnp.asarray(states))
    assert found == pytest.approx(gaussian_entropy(weights, states), rel=1e-9)
    known = np.column_stack([states, np.ones(50)])  # a component without variance
    assert np.isfinite(jax.jit(entropy)(jnp.log(jnp.asarray(weights)), jnp.asarray(known)))


def test_rewards_are_raised_by_the_entropy_taken():
    problem = drift(sensor_noise=0.2, end=50.0)
    belief = belief_of(problem, 400)
    settings = {"num_particles": 200, "iterations": 20, "leaf_value": StateValue()}
    trees = {}
    for weight in (None, 0.0, 3.0):
        of_weight = eqx.tree_at(
            lambda p: p.information,
            planner("pft", **settings),
            None if weight is None else number(weight),
            is_leaf=lambda leaf: leaf is None,
        )
        trees[weight] = search(of_weight, jax.random.key(5), problem, belief)
    np.testing.assert_array_equal(trees[None].outcome, trees[0.0].outcome)
    # The first branch of the root is the same in all trees.
    first = int(trees[3.0].branches[trees[3.0].children[ROOT, 0], 0])
    bonus = float(trees[3.0].outcome[first, 0] - trees[None].outcome[first, 0])
    # A prior of variance 1 moves with noise of variance 0.09, and is measured with variance 0.04.
    prior, before = 1.09, 0.5 * np.log(1.0)
    expected = 3.0 * (before - 0.5 * np.log(1.0 / (1.0 / prior + 1.0 / 0.04)))
    assert bonus == pytest.approx(expected, rel=0.2)


def test_nothing_is_paid_at_the_end():
    problem = drift(end=0.0)  # every step ends
    belief = ParticleSet(jnp.ones((20, 1)), jnp.ones(20, bool))
    step = eqx.filter_jit(BeliefStep(False))
    *_, is_terminal, later = step(jax.random.key(0), problem, belief, belief.states[0], jnp.zeros(1))
    assert is_terminal and np.isfinite(later)
