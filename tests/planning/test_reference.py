"""Every tree search grows the tree of its NumPy reference, from the same random numbers."""

import jax
import numpy as np
import pytest

from bojax.planning.cbts import ContinuousBeliefTreeSearch
from bojax.planning.discrete import DiscreteTreeSearch
from tests.planning.samples import POSES, f64, gps_abt, kcbts, parking, sbo, search
from tests.reference.bridge import drawn, reference_belief, reference_planner, reference_problem
from tests.reference.compare import assert_same_tree, nodes_of
from tests.tiers import by_tier

VARIANTS = {
    "kcbts": kcbts(),
    "kcbts, no exploration": kcbts(exploration=0.0),
    "kcbts, much exploration": kcbts(exploration=1000.0),
    "kcbts, discount": kcbts(discount=0.8),
    "kcbts, convergence": kcbts(convergence=1.0),
    "kcbts, ranks, log-ei, depth 1": kcbts("log-ei", scaling="rank", depth=1),
    "kcbts, log-ei, depth 2": kcbts("log-ei", depth=2),
    "kcbts, unscaled, pi, discount": kcbts("pi", scaling="none", num_initial=0, discount=0.9),
    "sbo-5": sbo(5),
    "sbo-5, discount": sbo(5, discount=0.8),
    "sbo-17": sbo(17, iterations=150),
    "gps-abt": gps_abt(),
    "gps-abt, much exploration": gps_abt(exploration=1000.0, discount=0.95),
    "gps-abt, no rollout, depth 2": gps_abt(heuristic="zero", depth=2),
}

EASY = "anywhere-bearing-dropped"
"""The rule under which small trees have parked robots."""

SLOW = {"kcbts, log-ei, depth 2", "sbo-17", "gps-abt", "gps-abt, much exploration"}
"""Other combinations of what the rest covers, and rollouts, which `test_field_reference` covers."""


def grow(planner, problem, seed, belief):
    grown = search(planner, jax.random.key(seed), problem, belief)
    tree, memory, recommended, begun = jax.tree.map(np.asarray, grown)
    draws = drawn(planner, problem, jax.random.key(seed))
    reference = reference_planner(planner, reference_problem(problem, planner), *begun, draws)
    root = reference.search(reference_belief(belief))
    return tree, memory, recommended, reference, root


def assert_same_plan(planner, grown):
    tree, memory, recommended, reference, root = grown
    assert_same_tree(tree, root, planner.num_actions)
    for node in nodes_of(root)[1:]:
        _assert_same_action(planner, memory, reference, node)
    assert recommended == reference.recommend(root).index
    _assert_reference_adds_up(root, planner)


@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
@pytest.mark.parametrize("name", by_tier(VARIANTS, normal=VARIANTS.keys() - SLOW))
def test_the_tree_is_that_of_the_reference(name, pose):
    problem = parking(rule=EASY)
    for seed in range(2):
        assert_same_plan(VARIANTS[name], grow(VARIANTS[name], problem, seed, f64(pose)))


@pytest.mark.parametrize(
    "settings",
    [
        {"bearing": "robot", "rule": "anywhere"},
        {"exit_terminates": False, "rule": "bearing-dropped"},
        {},
    ],
    ids=["robot's bearing", "exits end no episode", "as printed"],
)
def test_the_tree_follows_the_problem(settings):
    problem = parking(**settings)
    for pose in POSES.values():
        tree, _, _, _, root = grow(sbo(5), problem, 3, f64(pose))
        assert_same_tree(tree, root, 5)


def test_the_cases_contain_ends_and_full_depth():
    # What the comparison above is worth: its trees must have terminal nodes of both kinds.
    rewards, depths = set(), set()
    for pose in POSES.values():
        _, _, _, _, root = grow(VARIANTS["kcbts"], parking(rule=EASY), 0, f64(pose))
        rewards |= {node.reward for node in nodes_of(root) if node.is_terminal}
        depths |= {node.depth for node in nodes_of(root)}
    assert rewards == {1000.0, -1000.0}
    assert depths == {0, 1, 2, 3}


def _assert_same_action(planner, memory, reference, node):
    if isinstance(planner, DiscreteTreeSearch):
        assert int(memory.action[node.index]) == node.action
        return
    is_candidate = isinstance(planner, ContinuousBeliefTreeSearch)
    params = reference.candidates[node.action] if is_candidate else node.action
    np.testing.assert_allclose(memory.params[node.index], params, rtol=0.0, atol=1e-12)


def _assert_reference_adds_up(root, planner):
    """The total return of an action is its reward for each visit, and what followed these."""
    discount = float(planner.discount)
    for node in nodes_of(root):
        followed = sum(node.rollouts) + sum(child.total_return for child in node.children)
        weight = discount if node.parent is not None else 1.0
        expected = node.reward * node.visits + weight * followed
        np.testing.assert_allclose(node.total_return, expected, rtol=1e-9, atol=1e-9)
