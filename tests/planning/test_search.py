"""What holds in every search tree."""

import jax
import numpy as np
import pytest

from bojax.planning.cbts import ContinuousBeliefTreeSearch
from bojax.planning.discrete import DiscreteTreeSearch
from bojax.planning.tree import ROOT, UNVISITED
from tests.planning.samples import POSES, f64, gps_abt, kcbts, parking, sbo, search

TREE_PLANNERS = {"kcbts": kcbts, "sbo": sbo, "gps-abt": gps_abt}
# A node of GPS-ABT may get more actions than its tree lists; "beside the lot" it does.
CASES = [
    (name, pose) for name in TREE_PLANNERS for pose in POSES if (name, pose) != ("gps-abt", "beside the lot")
]


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}, {case[1]}")
def grown(request):
    """A planner and its tree, as NumPy arrays."""
    name, pose = request.param
    planner = TREE_PLANNERS[name]()
    tree, *_ = search(planner, jax.random.key(7), parking(), f64(POSES[pose]))
    return planner, jax.tree.map(np.asarray, tree)


def test_every_iteration_visits_the_root(grown):
    planner, tree = grown
    assert tree.visits[ROOT] == planner.iterations


def test_a_visit_goes_on_to_one_child(grown):
    planner, tree = grown
    for node, depth in _nodes(tree):
        if node != ROOT and depth < planner.depth and not tree.is_terminal[node]:
            # The visit that made the node went on to a rollout.
            assert tree.visits[node] == 1 + tree.visits[_children(tree, node)].sum()
    assert tree.visits[ROOT] == tree.visits[_children(tree, ROOT)].sum()


def test_no_node_is_deeper_than_the_horizon_or_past_an_end(grown):
    planner, tree = grown
    for node, depth in _nodes(tree):
        assert depth <= planner.depth
        if depth == planner.depth or tree.is_terminal[node]:
            assert len(_children(tree, node)) == 0


def test_no_node_has_more_actions_than_allowed(grown):
    planner, tree = grown
    match planner:
        case DiscreteTreeSearch():
            most = int(planner.motions.count)
        case ContinuousBeliefTreeSearch():
            most = int(planner.max_actions.sum())
        case _:
            most = planner.num_actions
    assert all(len(_children(tree, node)) <= most for node, _ in _nodes(tree))


@pytest.mark.parametrize(
    "planners",
    [[sbo(actions) for actions in (5, 9, 17)], [kcbts(max_actions=most) for most in (1, 10, 20)]],
    ids=["sbo", "kcbts"],
)
def test_any_number_of_actions_shares_a_program(planners):
    small, *others = map(jax.tree.flatten, planners)
    for leaves, structure in others:
        assert structure == small[1]
        assert [leaf.shape for leaf in leaves] == [leaf.shape for leaf in small[0]]


def test_every_node_has_one_parent(grown):
    _, tree = grown
    nodes = [node for node, _ in _nodes(tree)]
    assert len(nodes) == len(set(nodes)) == np.count_nonzero(tree.visits)


def test_returns_are_between_the_worst_and_the_best(grown):
    planner, tree = grown
    for node, depth in _nodes(tree):
        if node != ROOT:
            actions = planner.depth - depth + 1
            assert -1000.0 * actions <= tree.total_return[node] / tree.visits[node] <= 1000.0


def test_a_converged_node_gets_no_new_actions():
    # Any two actions are closer than this: no node has more than two.
    planner = kcbts(convergence=100.0)
    tree, *_ = search(planner, jax.random.key(0), parking(), f64(POSES["far"]))
    tree = jax.tree.map(np.asarray, tree)
    assert max(len(_children(tree, node)) for node, _ in _nodes(tree)) == 2


def test_nothing_converges_at_a_threshold_of_zero():
    planner = kcbts(convergence=0.0)
    tree, *_ = search(planner, jax.random.key(0), parking(), f64(POSES["far"]))
    tree = jax.tree.map(np.asarray, tree)
    assert len(_children(tree, ROOT)) == int(planner.max_actions.sum()) == 6


def _children(tree, node):
    return tree.children[node][tree.children[node] != UNVISITED]


def _nodes(tree):
    """(node, depth) of all nodes that the root leads to."""
    found, open_nodes = [], [(ROOT, 0)]
    while open_nodes:
        node, depth = open_nodes.pop()
        found.append((node, depth))
        open_nodes += [(child, depth + 1) for child in _children(tree, node)]
    return found
