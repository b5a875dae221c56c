"""On a field every tree search grows the tree of a NumPy reference that refits the belief at every node."""

from collections import Counter
from itertools import chain

import numpy as np
import pytest

from bojax.models.kernels import RBF, Matern12, Matern32, Matern52, Product, Scaled, Sum
from bojax.models.means import ConstantMean, LinearMean
from tests.planning.samples import (
    FIELD_POSES,
    OBJECTIVES,
    cubic_curves,
    f64,
    field_belief,
    gps_abt,
    kcbts,
    monitoring,
    sbo,
)
from tests.planning.test_reference import assert_same_plan, grow
from tests.reference.compare import nodes_of
from tests.tiers import by_tier

GRADIENT = OBJECTIVES["gradient"]
ROUGH = Sum(Scaled(Matern32(f64([0.5, 0.9])), f64(0.7)), Scaled(RBF(f64(1.5)), f64(0.4)))

VARIANTS = {
    "sbo-5": (sbo(5), monitoring()),
    "sbo-9, depth 1": (sbo(9, depth=1), monitoring("value, variance")),
    "sbo-5, discount, robot stays where it was stopped": (
        sbo(5, discount=0.8),
        monitoring("uncertainty", after_collision="stop"),
    ),
    "bo-pomdp": (sbo(5, objective=GRADIENT), monitoring()),
    "bo-pomdp, matern 1/2, the mean imagined": (
        sbo(5, depth=2),
        monitoring("gradient", Matern12(f64(0.8)), ConstantMean(f64(0.7)), imagined="mean"),
    ),
    "cbts": (
        kcbts(motions=cubic_curves()),
        monitoring("gradient", ROUGH, LinearMean(f64([0.3, -0.2]), f64(0.1))),
    ),
    "kcbts": (kcbts(), monitoring()),
    "kcbts, gradient, log-ei, no walls": (
        kcbts("log-ei", discount=0.9),
        monitoring("gradient", Matern52(f64(0.7)), walls=None),
    ),
    "kcbts, uncertainty, variance at the nodes, the mean imagined": (
        kcbts("ucb, variance", depth=2, objective=OBJECTIVES["uncertainty"]),
        monitoring(imagined="mean", kernel=Product(Matern32(f64(0.8)), RBF(f64(1.2)))),
    ),
    "gps-abt": (gps_abt(), monitoring(noise_variance=1e-4)),
    "gps-abt, gradient, no rollout": (gps_abt(heuristic="zero", discount=0.95), monitoring("gradient")),
}
NORMAL = {"sbo-5", "bo-pomdp", "cbts", "kcbts, gradient, log-ei, no walls", "gps-abt"}
"""One variant of each planner; in the slow tier the others, whose parts have tests of their own."""

OBSERVATIONS = {"in a room": 0, "before a wall": 7, "in the gap": 24, "at the border": 3, "in a corner": 1}


def cases(planner, problem, seeds=1):
    for seed in range(seeds):
        for name, pose in FIELD_POSES.items():
            belief = field_belief(problem, pose, OBSERVATIONS[name], seed=seed)
            yield grow(planner, problem, seed, belief)


@pytest.mark.parametrize("name", by_tier(VARIANTS, normal=NORMAL))
def test_the_tree_is_that_of_the_reference(name):
    planner, problem = VARIANTS[name]
    for grown in cases(planner, problem):
        assert_same_plan(planner, grown)


def test_a_plan_is_made_under_the_hyperparameters_of_the_belief():
    # They are the problem's until they are learned anew.
    planner, problem = VARIANTS["bo-pomdp"]
    learned = monitoring(kernel=Scaled(RBF(f64(0.9)), f64(1.7)), noise_variance=0.05)
    for name, pose in FIELD_POSES.items():
        belief = field_belief(learned, pose, OBSERVATIONS[name])
        grown = grow(planner, problem, 0, belief)
        assert_same_plan(planner, grown)
        same = grow(planner, learned, 0, belief)
        np.testing.assert_array_equal(grown[0].total_return, same[0].total_return)


def test_the_cases_contain_walls_borders_and_full_depth():
    # What the comparison above is worth.
    taken, costs, depths = Counter(), set(), set()
    for *_, root in chain(*(cases(*VARIANTS[name]) for name in ("sbo-5", "bo-pomdp"))):
        nodes = nodes_of(root)[1:]
        taken.update(len(node.belief.x) - len(node.parent.belief.x) for node in nodes)
        depths |= {node.depth for node in nodes}
        for node in nodes:
            if len(node.belief.x) == len(node.parent.belief.x):
                costs.add(node.reward)
    assert depths == {1, 2, 3}
    assert {-5.0, -4.0} == costs
    # Paths of six samples that are cut after each of them, and whole ones.
    assert all(taken[number] > 5 for number in range(7))
