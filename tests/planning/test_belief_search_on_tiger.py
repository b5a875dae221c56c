"""Belief searches on the tiger problem, whose optimal values are exact."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.lanes import LANES
from bojax.planning.leaf_values import LeafValue
from bojax.planning.tree import ROOT
from bojax.problems.particles import Particles
from bojax.problems.pomdp.tiger import Tiger
from tests.compiling import OPTIMISED
from tests.planning.belief_searches import number, planner, totals_by_action
from tests.tiers import by_tier

ACCURACY, DISCOUNT, VALUE = 0.85, 0.95, 19.371368
LISTEN = 0
NUM_LANES = 16
TIGER = Tiger(number(-1.0), number(-100.0), number(10.0), number(ACCURACY), number(DISCOUNT), 100)


def right_after(net_hearings):
    """Probability that the tiger is on the right."""
    odds = (ACCURACY / (1 - ACCURACY)) ** net_hearings
    return odds / (1 + odds)


def backed_up(value, right):
    """Values of the three actions for beliefs `right`, if the next belief has the value `value`."""
    hears_right = right * ACCURACY + (1 - right) * (1 - ACCURACY)
    after_right, after_left = right * ACCURACY / hears_right, right * (1 - ACCURACY) / (1 - hears_right)
    listen = -1 + DISCOUNT * (hears_right * value(after_right) + (1 - hears_right) * value(after_left))
    again = DISCOUNT * value(0.5)
    return np.stack([listen, 10 * right - 100 * (1 - right) + again, 10 * (1 - right) - 100 * right + again])


@cache
def optimal():
    """Beliefs and their optimal values, by value iteration."""
    grid = np.linspace(0.0, 1.0, 4001)
    values = np.zeros_like(grid)
    for _ in range(400):
        values = backed_up(lambda right, values=values: np.interp(right, grid, values), grid).max(axis=0)
    return grid, values


class BeliefValue(LeafValue):
    """A value of the belief that the states are, interpolated."""

    grid: jax.Array
    values: jax.Array

    def __call__(self, key, problem, states, alive, remaining):
        return jnp.interp(jnp.mean(states), self.grid, self.values)


def constant():
    """The same value for every belief."""
    grid, values = optimal()
    return BeliefValue(jnp.asarray(grid), jnp.asarray(np.full(len(values), VALUE)))


@cache
def searches(name):
    """A search in several lanes, of depth 2, as a function of keys, a belief and a leaf value."""
    settings = {"exploration": 20.0, "observation_widening": (10.0, 0.0), "depth": 2, "max_branches": 11}
    settings |= {"num_particles": 200, "num_reservoirs": 256}

    def search(keys, belief, leaf_value):
        search_planner = planner(name, 1500, **settings, leaf_value=leaf_value)
        return jax.vmap(lambda key: search_planner.search(key, TIGER, belief), axis_name=LANES)(keys)

    return jax.jit(search, compiler_options=OPTIMISED)


def trees(name, net_hearings, leaf_value):
    """Trees of several lanes."""
    right = right_after(net_hearings)
    states, log_weights = jnp.asarray([[0.0], [1.0]]), jnp.log(jnp.asarray([1 - right, right]))
    belief = Particles(states, log_weights, jnp.zeros(2, bool))
    return searches(name)(jax.random.split(jax.random.key(7), NUM_LANES), belief, leaf_value)


def root_values(trees):
    """Mean returns of the root's actions, a row each lane."""
    visits, returns = np.moveaxis(totals_by_action(trees)[:, ROOT], -1, 0)
    return returns / np.maximum(visits, 1.0)


def value_of_listening(trees, lane):
    """The value of listening, then the action that the search prefers: free of its exploration."""
    totals = totals_by_action(trees)[lane]
    branches = np.asarray(trees.branches[lane, trees.children[lane, ROOT, LISTEN]])
    visits, returns = np.moveaxis(totals[branches], -1, 0)
    preferred = np.arange(len(branches)), visits.argmax(axis=1)
    return -1 + DISCOUNT * (returns[preferred] / visits[preferred]).mean()


def test_value_iteration_has_the_published_value():
    grid, values = optimal()
    assert np.interp(0.5, grid, values) == pytest.approx(VALUE, abs=1e-3)


OPENED = {0: 0, 1: 0, -1: 0, 2: 1, -2: 2}
"""The optimal action by the number of net hearings."""


@pytest.mark.parametrize("net_hearings", by_tier(OPENED, normal=[0, 2]))
def test_pft_listens_until_it_has_heard_the_tiger_twice(net_hearings):
    grid, values = optimal()
    forest = trees("pft", net_hearings, BeliefValue(jnp.asarray(grid), jnp.asarray(values)))
    chosen = root_values(forest).argmax(axis=1)
    assert np.sum(chosen == OPENED[net_hearings]) == NUM_LANES
    if net_hearings == 0:
        found = np.array([value_of_listening(forest, lane) for lane in range(NUM_LANES)])
        assert abs(found.mean() - VALUE) < 3 * found.std(ddof=1) / np.sqrt(NUM_LANES)


@pytest.mark.parametrize("net_hearings", by_tier([0, 1], normal=[1]))
def test_the_value_of_listening_is_exact_for_two_actions(net_hearings):
    def one_left(right):
        return backed_up(lambda right: VALUE + 0.0 * right, np.asarray(right)).max(axis=0)

    exact = backed_up(one_left, np.asarray(right_after(net_hearings)))[LISTEN]
    forest = trees("pft", net_hearings, constant())
    found = np.array([value_of_listening(forest, lane) for lane in range(NUM_LANES)])
    assert abs(found.mean() - exact) < 3 * found.std(ddof=1) / np.sqrt(NUM_LANES) + 1e-9
    returns = root_values(forest)
    assert np.mean(returns.argmax(axis=1) == LISTEN) > 0.9
    assert returns[:, LISTEN].mean() < found.mean()  # the search explores


@pytest.mark.parametrize("net_hearings", by_tier([0, 1], normal=[1]))
def test_branches_of_pomcpow_draw_from_the_posterior(net_hearings):
    # Values are no test of POMCPOW: the action preferred after few visits is one that was lucky.
    forest = trees("pomcpow", net_hearings, constant())
    nodes = np.stack(
        [forest.branches[lane, forest.children[lane, ROOT, LISTEN]] for lane in range(NUM_LANES)]
    )
    assert np.all(nodes[:, 2:] == ROOT)  # one branch for each side
    nodes = nodes[:, :2]
    lanes = np.arange(NUM_LANES)[:, None]
    heard = np.asarray(forest.beliefs.observation)[lanes, nodes, 0]
    right = np.asarray(forest.beliefs.steps)[lanes, nodes, :, 0].mean(axis=-1)
    totals = totals_by_action(forest)
    visits = totals[lanes, nodes, :, 0].sum(axis=-1)
    assert np.all(np.sort(heard) == [0.0, 1.0])
    counts = np.asarray(forest.beliefs.count)[lanes, nodes]
    drawn, hears_right = counts.sum(axis=1), right_after(net_hearings) * 0.7 + 0.15
    np.testing.assert_array_equal(drawn, totals[:, ROOT, LISTEN, 0])  # every visit draws
    shares = counts[heard == 1.0] / drawn
    assert abs(shares.mean() - hears_right) < 4 * (0.25 / drawn.sum()) ** 0.5
    for side in (0, 1):
        found, expected = right[heard == side], right_after(net_hearings + 2 * side - 1)
        # A ratio of sums over the visits is biased by the order of one over their number.
        tolerance = 3 * found.std(ddof=1) / np.sqrt(len(found)) + 1 / visits.mean()
        assert abs(found.mean() - expected) < tolerance
    assert np.mean(root_values(forest).argmax(axis=1) == LISTEN) > 0.9
