"""How close the actions of the root come to the best candidate before the last one."""

import equinox as eqx
import jax
import numpy as np
import pytest

from bojax.planning.tree import ROOT, UNVISITED
from tests.planning.samples import FIELD_POSES, f64, field_belief, kcbts, monitoring, path_of, plan
from tests.planning.test_probes import START, Target

TARGET = path_of(kcbts().motions, f64((0.5, 0.4, 0.3)))[-1, :2]


@eqx.filter_jit
def searched(planner, key, problem, belief):
    """The tree and the memory of a search, the rewards of its candidates, and what it measures."""
    tree, memory = planner.search(key, problem, belief)
    rewards = planner.candidate_rewards(problem, belief, memory)
    return tree, memory, rewards, planner.measure(problem, belief, tree, memory)


def rewards_of_children(tree, memory):
    """Indices of the candidates that the root has tried, in their order, and their rewards in the tree."""
    children = np.asarray(tree.children[ROOT])
    children = children[children != UNVISITED]
    same = np.all(np.asarray(memory.params)[children][:, None] == np.asarray(memory.candidates)[None], axis=2)
    assert np.all(same.any(axis=1))
    return same.argmax(axis=1), np.asarray(tree.reward)[children]


@pytest.mark.parametrize("most", [2, 6])
def test_it_is_the_lead_of_the_best_candidate_that_the_first_actions_leave(most):
    problem = Target(f64(0.0), f64(0.0), TARGET)
    planner = kcbts(depth=2, max_actions=most, measures_shortfall=True)
    found = []
    for seed in range(6):
        tree, memory, rewards, measured = searched(planner, jax.random.key(seed), problem, f64(START))
        ends = np.asarray(memory.paths)[:, -1, :2]
        expected = -np.linalg.norm(ends - np.asarray(TARGET), axis=1)
        np.testing.assert_allclose(rewards, expected, atol=1e-12)
        tried, _ = rewards_of_children(tree, memory)
        assert len(tried) == most
        early = expected[tried[:-1]].max()
        shortfall = (expected.max() - early) / (expected.max() - np.median(expected))
        np.testing.assert_allclose(measured["shortfall"], shortfall, atol=1e-9)
        found.append(shortfall)
    assert len(set(found)) > 1


def test_the_rewards_of_candidates_are_those_of_the_tree():
    problem = monitoring()
    planner = kcbts(measures_shortfall=True)
    for pose in FIELD_POSES.values():
        tree, memory, rewards, measured = searched(
            planner, jax.random.key(3), problem, field_belief(problem, pose, 7, seed=0)
        )
        tried, in_tree = rewards_of_children(tree, memory)
        np.testing.assert_allclose(np.asarray(rewards)[tried], in_tree, atol=1e-9)
        assert measured["shortfall"] >= 0.0


def test_measuring_changes_no_plan():
    problem = Target(f64(0.0), f64(0.0), TARGET)
    planners = (kcbts(depth=2, measures_shortfall=each) for each in (False, True))
    plain, measured = (plan(each, jax.random.key(0), problem, f64(START)) for each in planners)
    assert plain.measured == {} and set(measured.measured) == {"shortfall"}
    np.testing.assert_allclose(plain.action, measured.action, atol=1e-12)
    np.testing.assert_allclose(plain.value, measured.value, atol=1e-9)
    assert [column.name for column in kcbts(measures_shortfall=True).run_columns] == ["shortfall"]
