"""Plans of several trees: what they pool, against NumPy, and batches of such plans."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.lanes import LANES
from bojax.planning.leaf_values import StateValue
from bojax.planning.root_parallel import recommended_by_all
from bojax.planning.settings import POMCPOW
from bojax.planning.tree import RootActions
from bojax.problems.actions import Box, Discrete, Mixed
from tests.planning.belief_searches import ITERATIONS, belief_of, drift, number, planner, search

TREES = 3
LEAST = 1e-6
"""The smallest `merge_lengthscale`."""


def roots(parameters, visits, returns):
    """The actions of some trees, one row of each argument for a tree."""
    return RootActions(*(jnp.asarray(rows, float) for rows in (parameters, visits, returns)))


def pooled(space, roots, lengthscale, recommendation):
    """The action, its value and its visits, by loops."""
    coordinates, level = eqx.filter_jit(space.coordinates), eqx.filter_jit(space.level)
    roots = [list(zip(*root, strict=True)) for root in zip(*jax.device_get(tuple(roots)), strict=True)]
    visited = [[each for each in root if each[1]] for root in roots]
    mean, visits = (lambda each: each[2] / each[1]), (lambda each: each[1])
    nominees = [max(root, key=mean if recommendation == "value" else visits)[0] for root in visited]
    judged = []
    for nominee in nominees:
        alike, total = 0.0, 0.0
        for action, n, r in sum(visited, []):
            apart = np.asarray(coordinates(nominee)) - np.asarray(coordinates(action))
            if level(nominee) == level(action):
                similarity = np.exp(-0.5 * np.sum(apart**2) / lengthscale**2)
                alike, total = alike + similarity * n, total + similarity * r
        judged.append((nominee, total / alike, alike))
    return max(judged, key=lambda each: each[1 if recommendation == "value" else 2])


recommended = eqx.filter_jit(recommended_by_all)


@eqx.filter_jit
def plan(planner, key, problem, belief):
    return planner.plan(key, problem, belief)


@pytest.mark.parametrize("name", ["pft", "pomcpow"])
def test_a_plan_pools_the_trees_of_its_keys(name):
    problem = drift()
    belief = belief_of(problem)
    one, several = (planner(name, ITERATIONS, trees=trees, leaf_value=StateValue()) for trees in (1, TREES))
    trees = [
        search(one, each, problem, belief).root_actions()
        for each in jax.random.split(jax.random.key(3), TREES)
    ]
    action, value, visits = pooled(
        problem.actions, [np.stack(x) for x in zip(*trees, strict=True)], 0.3, "value"
    )
    found = plan(several, jax.random.key(3), problem, belief)
    np.testing.assert_allclose(found.action, action, rtol=1e-9)
    np.testing.assert_allclose(found.value, value, rtol=1e-9)
    assert found.visits == int(visits)
    assert visits > max(float(tree.visits.max()) for tree in trees)  # of several trees


def test_a_batch_of_plans_has_those_of_single_ones():
    problem = drift()
    belief = belief_of(problem)
    several = planner("pomcpow", ITERATIONS, trees=TREES, leaf_value=StateValue())
    batch = jax.vmap(lambda key: plan(several, key, problem, belief), axis_name=LANES)(
        jax.random.split(jax.random.key(4), 3)
    )
    alone = [plan(several, key, problem, belief) for key in jax.random.split(jax.random.key(4), 3)]
    np.testing.assert_allclose(batch.action, [each.action for each in alone], rtol=1e-12)
    np.testing.assert_allclose(batch.value, [each.value for each in alone], rtol=1e-12)
    assert len(set(np.ravel(batch.action).tolist())) == 3


@pytest.mark.parametrize("recommendation", ["value", "visits"])
@pytest.mark.parametrize("seed", range(3))
def test_random_roots_are_pooled_as_loops_do(recommendation, seed):
    rng = np.random.default_rng(seed)
    space = Mixed(Box(-jnp.pi * jnp.ones(1), jnp.pi * jnp.ones(1), is_angle=True), jnp.arange(2.0))
    visits = rng.integers(0, 9, (4, 6)) + (np.arange(6) == 0)
    some = roots(rng.uniform(-1.0, 1.0, (4, 6, 2)), visits, visits * rng.normal(size=(4, 6)))
    action, value, alike = pooled(space, some, 0.4, recommendation)
    best = recommended(space, some, number(0.4), recommendation == "value")
    np.testing.assert_allclose(best.parameters, action)
    np.testing.assert_allclose([best.value, best.visits], [value, alike], rtol=1e-6)


def test_angles_close_on_the_circle_are_alike_and_other_levels_are_not():
    space = Mixed(Box(-jnp.pi * jnp.ones(1), jnp.pi * jnp.ones(1), is_angle=True), jnp.arange(2.0))
    nearly_a_turn_apart = roots([[[-0.999, -0.5]], [[0.999, -0.5]]], [[1.0], [1.0]], [[1.0], [3.0]])
    best = recommended(space, nearly_a_turn_apart, number(0.2), True)
    assert best.visits == pytest.approx(2.0, abs=1e-3)
    assert best.value == pytest.approx(2.0, abs=1e-3)
    other_level = roots([[[-0.999, -0.5]], [[0.999, 0.5]]], [[1.0], [1.0]], [[1.0], [3.0]])
    best = recommended(space, other_level, number(0.2), True)
    assert (best.visits, best.value) == (1.0, 3.0)


def test_actions_of_a_list_are_pooled_with_themselves_alone():
    space = Discrete(jnp.eye(3))
    actions = [[[0], [1], [2]]] * 2
    some = RootActions(
        jnp.asarray(actions),
        jnp.asarray([[2.0, 2.0, 0.0], [6.0, 1.0, 1.0]]),
        jnp.asarray([[4.0, 2.0, 0.0], [6.0, 3.0, 0.0]]),
    )
    # The means are 2 and 1 in the first tree, 1, 3 and 0 in the second; together 10 / 8 and 5 / 3.
    best = recommended(space, some, number(0.2), True)
    assert best.parameters == 1
    assert best.value == pytest.approx(5 / 3, rel=1e-4)


def test_the_least_lengthscale_pools_actions_with_themselves_alone():
    with pytest.raises(ValueError, match="merge_lengthscale"):
        POMCPOW(merge_lengthscale=0.5 * LEAST)
    least = jnp.asarray(POMCPOW(merge_lengthscale=LEAST).merge_lengthscale, jnp.float32)
    some = RootActions(*(jnp.asarray(x, jnp.float32) for x in ([[[0.1]], [[0.2]]], [[1], [2]], [[1], [6]])))
    best = recommended(Box(-jnp.ones(1, jnp.float32), jnp.ones(1, jnp.float32)), some, least, True)
    assert (best.visits, best.value) == (2.0, 3.0)
