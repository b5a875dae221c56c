"""Every planner of paths: its plans, their expected rewards, batches and hyper-parameters."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.planning.base import Plan
from bojax.planning.belief_search import BeliefTreeSearch
from bojax.planning.myopic import MyopicPlanner
from bojax.planning.search import TreeSearch
from tests.parts import first_kinds, tiny
from tests.planning.samples import (
    FIELD_POSES,
    POSES,
    f64,
    field_belief,
    kcbts,
    monitoring,
    parking,
    plan,
    plans,
    sbo,
)
from tests.reference.bridge import reference_belief, reference_problem
from tests.tiers import by_tier

LANES = 3
PROBLEMS = ("parking", "monitoring")


@functools.cache
def task(problem):
    """A problem and beliefs, one for each lane."""
    if problem == "parking":
        return parking(), [f64(POSES[name]) for name in ("far", "before the lot", "at the border")]
    starts = (("in a room", 4), ("before a wall", 0), ("at the border", 24))
    beliefs = [field_belief(monitoring(), FIELD_POSES[name], count) for name, count in starts]
    return monitoring("gradient"), beliefs


PLANNERS = {
    kind: tiny("planner", kind, **{"iterations": 60} if "iterations" in schema.model_fields else {})
    for kind, schema in kinds("planner").items()
    if "motions" in schema.model_fields
}


def takes(kind: str, problem: str) -> bool:
    """Whether a planner can plan on a problem: an objective of its own needs a field."""
    return problem == "monitoring" or getattr(PLANNERS[kind], "objective", None) is None


CASES = [(kind, problem) for kind in PLANNERS for problem in PROBLEMS if takes(kind, problem)]

FIRST = [
    next(case for case in CASES if case[0] == kind) for kind in first_kinds("planner") if kind in PLANNERS
]
"""One planner of each class, on parking, whose programs compile in half of the time.

The other cases are slow: `test_field_reference` compares plans on a field with NumPy.
"""


@functools.cache
def built(kind):
    return build(PLANNERS[kind], "float64")


@pytest.fixture(params=by_tier(CASES, normal=FIRST), ids="-".join, scope="module")
def case(request):
    """A planner, a problem and beliefs, one for each lane."""
    kind, problem = request.param
    return built(kind), *task(problem)


@pytest.fixture
def planner(case):
    return case[0]


@pytest.fixture
def problem(case):
    return case[1]


@pytest.fixture
def beliefs(case):
    return case[2]


def keys():
    """Keys of the lanes, new objects each time: a key is used once."""
    return jax.random.split(jax.random.key(5), LANES)


def test_a_plan_is_a_path_and_what_is_expected_of_it(planner, problem, beliefs):
    result = plan(planner, keys()[0], problem, beliefs[0])
    assert isinstance(result, Plan)
    assert result.path.shape == (planner.motions.num_samples, 3)
    assert jnp.all(jnp.isfinite(result.path))
    assert {leaf.dtype for leaf in (result.path, result.reward, result.value)} == {jnp.dtype(jnp.float64)}
    assert jnp.issubdtype(result.visits.dtype, jnp.integer) and result.visits >= 1
    # Paths start at the robot and are one metre long.
    assert jnp.linalg.norm(result.path[0, :2]) <= 1.0 / len(result.path) + 1e-9
    assert jnp.linalg.norm(result.path[-1, :2]) <= 1.0 + 1e-9


def test_the_expected_reward_is_that_of_the_path(planner, problem, beliefs):
    result = plan(planner, keys()[1], problem, beliefs[1])
    nothing_drawn = np.zeros(len(result.path))
    belief = reference_belief(beliefs[1])
    _, reward, _ = reference_problem(problem, planner).drive(belief, np.asarray(result.path), nothing_drawn)
    np.testing.assert_allclose(result.reward, reward, rtol=1e-9)


def test_keys_matter(planner, problem, beliefs):
    first, second = (plan(planner, keys()[i], problem, beliefs[0]) for i in range(2))
    is_same = jnp.array_equal(first.path, second.path) and first.value == second.value
    assert is_same == isinstance(planner, MyopicPlanner)  # which tries everything there is


@pytest.mark.parametrize("case", FIRST, ids="-".join, scope="module", indirect=True)
def test_a_batch_is_a_loop_and_its_lanes_differ(planner, problem, beliefs):
    # Keys, beliefs and every hyper-parameter are a batch axis; those of the lanes differ by up to a fifth.
    planners = [scaled(planner, 1.0 - 0.1 * lane) for lane in range(LANES)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *planners)
    with jax.debug_key_reuse(False):  # JAX's check takes any scan over a batch of keys for a reuse
        together = jax.tree.map(lambda *leaves: jnp.stack(leaves), *beliefs)
        lanes = plans(batch, keys(), problem, together)
    for lane in range(LANES):
        alone = plan(planners[lane], keys()[lane], problem, beliefs[lane])
        np.testing.assert_allclose(lanes.path[lane], alone.path, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(lanes.value[lane], alone.value, rtol=1e-9)
        assert lanes.visits[lane] == alone.visits
    assert len({float(value) for value in lanes.value}) == LANES


def scaled(part, factor):
    """A part with all numbers multiplied; Booleans and choices stay."""
    return jax.tree.map(
        lambda leaf: factor * leaf if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, part
    )


def test_more_exploration_spreads_the_visits(planner, problem, beliefs):
    # A weight of exploration captured as a constant would give the same plan twice.
    if not isinstance(planner, TreeSearch | BeliefTreeSearch):
        assert plan(planner, keys()[0], problem, beliefs[0]).visits == 1
        return
    few, many = (
        plan(eqx.tree_at(lambda p: p.exploration, planner, f64(weight)), keys()[0], problem, beliefs[0])
        for weight in (0.0, 10_000.0)
    )
    assert few.visits > many.visits


def test_any_number_of_actions_shares_a_program():
    for planners in (
        [sbo(actions) for actions in (5, 9, 17)],
        [kcbts(max_actions=most) for most in (1, 10, 20)],
    ):
        small, *others = map(jax.tree.flatten, planners)
        for leaves, structure in others:
            assert structure == small[1]
            assert [leaf.shape for leaf in leaves] == [leaf.shape for leaf in small[0]]
