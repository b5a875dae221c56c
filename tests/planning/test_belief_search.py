"""Belief searches: the same tree as a NumPy reference, and what holds for every tree."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from bojax.numerics.lanes import LANES
from bojax.planning.leaf_values import Rollout, StateValue
from bojax.planning.proposals import VoronoiProposal
from bojax.planning.tree import ROOT
from bojax.planning.widening import Widening
from bojax.problems.particles import Particles
from tests.planning import belief_searches
from tests.planning.belief_searches import (
    ITERATIONS,
    SETTINGS,
    BinaryDrift,
    Drift,
    belief_of,
    drift,
    number,
    planner,
    reference_tree,
    totals_by_action,
)
from tests.reference import belief_search as reference
from tests.tiers import by_tier

KEY = 5  # of a search
BINARY = {"problem": BinaryDrift, "leaf_value": StateValue()}


def capacity(k, alpha, visits):
    """Largest number of children after these visits."""
    return int(min(visits, k * max(visits - 1, 0) ** alpha + 1))


def search(planner, problem, belief):
    return belief_searches.search(planner, jax.random.key(KEY), problem, belief)


def compare(tree, node, expected):
    """The subtree of `node` against the reference's; returns the number of belief nodes."""
    visits, totals = totals_by_action(tree)[node].T
    actions = expected.actions + [reference.Action()] * (len(visits) - len(expected.actions))
    np.testing.assert_array_equal(visits, [action.visits for action in actions])
    np.testing.assert_allclose(totals, [action.total for action in actions], rtol=1e-9, atol=1e-12)
    count = 1
    for slot, action in enumerate(actions):
        if action.visits:
            index = int(tree.children[node, slot])
            np.testing.assert_allclose(tree.parameters[index], action.parameters, rtol=1e-12)
            if action.counts is not None:
                drawn = tree.beliefs.count[tree.branches[index, : len(action.counts)]]
                np.testing.assert_array_equal(drawn, action.counts)
            for branch, child in enumerate(action.branches):
                count += compare(tree, int(tree.branches[index, branch]), child)
    return count


@pytest.mark.parametrize(
    "name, changes",
    [
        ("pft", {}),
        ("pft", {"discrete": True, "leaf_value": StateValue()}),
        ("pft", {"sensor_noise": 0.0}),  # no particle has a weight
        ("pomcpow", {}),
        pytest.param("pomcpow", {"discrete": True, "leaf_value": StateValue()}, marks=pytest.mark.slow),
        ("pomcpow", BINARY),  # both observations of every action
        pytest.param(
            "pomcpow",
            {"problem": BinaryDrift, "discrete": True, "observation_widening": (1.0, 0.1)},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_tree_is_that_of_the_reference(name, changes):
    kind = changes.get("problem", Drift)
    problem = drift(changes.get("sensor_noise", 0.5), discrete=changes.get("discrete", False), kind=kind)
    belief, search_planner = belief_of(problem), planner(name, ITERATIONS, **changes)
    tree = search(search_planner, problem, belief)
    expected = reference_tree(search_planner, jax.random.key(KEY), problem, belief)
    assert compare(jax.device_get(tree), ROOT, expected) > 60
    best = int(tree.root_actions().recommended(by_value=True).slot)
    visited = [action for action in expected.actions if action.visits]
    assert expected.actions[best] is max(visited, key=lambda action: action.mean)


class DriftDraws:
    """The steps of `drift()`, and draws of a search, in plain NumPy."""

    def __init__(self, states, seed):
        self.states, self.rng = states, np.random.default_rng(seed)

    def begin(self, i):
        pass

    def state(self):
        return self.rng.choice(self.states)

    def action(self):
        return self.rng.uniform(-1.0, 1.0, 1)

    def decode(self, parameters):
        return parameters

    def branch(self, level, number):
        return self.rng.integers(number)

    def by_weight(self, weights):
        return self.rng.choice(len(weights), p=np.array(weights) / np.sum(weights))

    def leaf_value(self, states, alive, left):
        total, state, is_alive = 0.0, states[0], alive[0]
        for step in range(left if is_alive else 0):
            state, reward, ended = self._step(state, self.action())
            total += 0.9**step * reward
            if ended:
                break
        return total

    def new_step(self, state, action):
        next_state, reward, ended = self._step(state, action)
        observation = next_state + 0.5 * self.rng.normal(size=1)
        return next_state, reward, ended, observation, self._likelihood(observation, next_state)

    def next_step(self, level, state, action, observation):
        next_state, reward, ended = self._step(state, action)
        return next_state, reward, ended, self._likelihood(observation, next_state)

    def _step(self, state, action):
        moved = state + action + 0.3 * self.rng.normal(size=1)
        ended = abs(moved[0]) > 2.0
        return moved, (-5.0 if ended else -(moved[0] ** 2)), ended

    def _likelihood(self, observation, state):
        return np.exp(-0.5 * ((observation[0] - state[0]) / 0.5) ** 2)


@pytest.mark.slow
def test_many_reservoirs_search_as_published_lists_do():
    problem, num = drift(), 128
    belief = belief_of(problem)
    reservoirs = planner("pomcpow", ITERATIONS, num_reservoirs=64, max_branches=40)
    in_batch = jax.vmap(lambda key: reservoirs.search(key, problem, belief), axis_name=LANES)
    trees = eqx.filter_jit(in_batch)(jax.random.split(jax.random.key(8), num))
    totals = totals_by_action(trees)[:, ROOT]
    states = np.asarray(belief.states)
    settings = SETTINGS | {"discount": 0.9, "num_actions": None, "max_branches": 40}
    roots = [
        reference.POMCPOWWithLists(DriftDraws(states, seed), **settings).search(None, ITERATIONS)
        for seed in range(num)
    ]
    # Statistics of the root: the mean return of all simulations, the highest mean, most visits, actions.
    visits = totals[..., 0]
    means = np.where(visits > 0, totals[..., 1] / np.maximum(visits, 1), -np.inf)
    found = totals[..., 1].sum(axis=1) / ITERATIONS, means.max(axis=1), visits.max(axis=1)
    expected = (
        [sum(a.total for a in root.actions) / ITERATIONS for root in roots],
        [max(a.mean for a in root.actions) for root in roots],
        [max(a.visits for a in root.actions) for root in roots],
    )
    for ours, theirs in zip(found, expected, strict=True):
        error = np.hypot(np.std(ours, ddof=1), np.std(theirs, ddof=1)) / np.sqrt(num)
        assert abs(np.mean(ours) - np.mean(theirs)) < 3.5 * error
    assert {int(np.sum(row > 0)) for row in visits} == {len(root.actions) for root in roots}


@pytest.mark.parametrize(
    "k, alpha", [(1.0, 0.5), (3.0, 0.3), (20.0, 0.04), (2.5, 0.01), (4.0, 0.0), (1.0, 1.0)]
)
def test_thresholds_are_the_rule_of_widening(k, alpha):
    thresholds = np.asarray(Widening(number(k), number(alpha)).thresholds(60))
    children = 0
    for visits in range(50):
        if children <= k * visits**alpha and (visits or not children):
            children += 1
        assert np.sum(thresholds <= visits) == children
    assert children == capacity(k, alpha, 50)


def test_a_threshold_that_a_device_rounds_up_is_whole(monkeypatch):
    power = jnp.power  # as on a GPU, where 37.0 ** 1.0 is larger than 37
    rounded = lambda x, y: jnp.nextafter(power(x, y), jnp.inf)  # noqa: E731
    widening = Widening(number(1.0), number(1.0))
    monkeypatch.setattr(type(number(1.0)), "__pow__", rounded)
    assert np.array_equal(widening.thresholds(60), np.arange(60))


@pytest.mark.parametrize("name", ["pft", "pomcpow"])
def test_visits_add_up_and_widening_is_bounded(name):
    problem = drift()
    tree = search(planner(name, ITERATIONS), problem, belief_of(problem))
    visits = totals_by_action(tree)[..., 0]
    assert visits[ROOT].sum() == ITERATIONS
    seen = {ROOT}
    for node in range(ITERATIONS + 1):
        actions = np.flatnonzero(visits[node])
        if node not in seen:  # nodes have higher indices than their parents
            assert not len(actions)
            continue
        at_node = visits[node].sum()
        assert len(actions) <= max(1, SETTINGS["widening"][0] * at_node ** SETTINGS["widening"][1] + 1)
        for slot in actions:
            k, alpha = SETTINGS["observation_widening"]
            num_branches = min(capacity(k, alpha, int(visits[node, slot])), SETTINGS["max_branches"])
            branches = np.asarray(tree.branches[tree.children[node, slot]])
            added = branches[:num_branches]
            assert np.all(added > node) and not seen & set(added)
            assert np.all(branches[num_branches:] == 0)
            seen |= set(added)
            # The other visits went on to a branch, and on from there unless the simulation ended.
            assert visits[added].sum() <= visits[node, slot] - num_branches
    assert len(seen) > 100


@pytest.mark.parametrize("published", [False, True])
@pytest.mark.parametrize("name", ["pft", "pomcpow"])
def test_beliefs_without_weights_or_living_states_give_no_nan(name, published):
    if name == "pomcpow" and published:
        pytest.skip("POMCPOW has one treatment of termination")
    for sensor_noise, end in [(0.0, 2.0), (1e-200, 2.0), (0.5, 0.0), (0.0, 0.0)]:
        problem = drift(sensor_noise, end)
        belief = belief_of(problem)
        ended = Particles(belief.states, belief.log_weights, jnp.ones_like(belief.terminal))
        weightless = Particles(belief.states, jnp.full_like(belief.log_weights, -jnp.inf), belief.terminal)
        for each in (belief, ended, weightless):
            tree = search(planner(name, ITERATIONS, published=published), problem, each)
            assert np.all(np.isfinite(tree.totals))
            assert totals_by_action(tree)[ROOT, :, 0].sum() == ITERATIONS


@pytest.mark.parametrize("name, changes", [("pft", {}), ("pomcpow", {}), ("pomcpow", BINARY)])
def test_a_lane_of_a_batch_is_a_search_of_its_own(name, changes):
    problem = drift(kind=changes.get("problem", Drift))
    keys = jax.random.split(jax.random.key(2), 3)
    beliefs = [belief_of(problem, seed=seed) for seed in range(3)]
    together = jax.tree.map(lambda *leaves: jnp.stack(leaves), *beliefs)
    one = planner(name, ITERATIONS, **changes)
    in_batch = jax.vmap(lambda key, belief: one.search(key, problem, belief), axis_name=LANES)
    batch = eqx.filter_jit(in_batch)(jnp.copy(keys), together)
    for lane, belief in enumerate(beliefs):
        tree = belief_searches.search(one, keys[lane], problem, belief)
        np.testing.assert_array_equal(batch.totals[lane, ..., 0], tree.totals[..., 0])
        np.testing.assert_allclose(batch.totals[lane, ..., 1], tree.totals[..., 1], rtol=1e-9, atol=1e-9)
        if changes:
            np.testing.assert_array_equal(batch.beliefs.count[lane], tree.beliefs.count)


class Arrivals(Drift):
    """A drift with draws that suit JAX's own keys alone."""

    draw = staticmethod(jax.random.poisson)

    def step(self, key, state, action):
        key, own = jax.random.split(key)
        after, reward, is_terminal = super().step(key, state, action)
        return after + self.draw(own, 3.0, after.shape).astype(after.dtype), reward, is_terminal


class Waits(Arrivals):
    draw = staticmethod(jax.random.gamma)


@pytest.mark.parametrize("kind", [Arrivals, Waits])
def test_a_model_may_draw_numbers_that_take_keys_of_jax(kind):
    kinds = set()

    def step(self, key, state, action):
        kinds.add(str(jax.random.key_impl(key)))
        return kind.step(self, key, state, action)

    problem = drift(kind=type("Observed", (kind,), {"step": step}))
    tree = search(planner("pft", 20), problem, belief_of(problem))
    assert totals_by_action(tree)[ROOT, :, 0].sum() == 20 and "threefry2x32" in kinds


def test_voronoi_proposals_lie_in_the_cell_of_the_best_action():
    problem = drift()
    tree = search(planner("pft", ITERATIONS), problem, belief_of(problem))
    sd, num_candidates, num = np.sqrt(0.3), 4, 2000
    proposal = VoronoiProposal(number(0.0), number([sd**2]), number(0.0), num_candidates)

    @eqx.filter_jit
    def propose(proposal):
        keys = jax.random.split(jax.random.key(3), num)
        root = jnp.asarray(ROOT, jnp.int32)
        totals = tree.totals_of(tree.children[ROOT])
        of_key = lambda key: proposal(key, problem.actions, tree, root, totals)  # noqa: E731
        return jax.vmap(of_key)(keys)[:, 0]

    proposed = np.asarray(propose(proposal))
    means = np.asarray(tree.root_actions().values())
    actions = np.asarray(tree.parameters[tree.children[ROOT], 0])[np.isfinite(means)]
    best = actions[np.argmax(means)]
    nearest = actions[np.argmin(np.abs(proposed[:, None] - actions), axis=1)]
    # The cell of an action ends half way to its neighbours, or with the space.
    ordered = np.concatenate([[-np.inf], np.sort(actions), [np.inf]])
    at = np.flatnonzero(ordered == best)[0]
    ends = (ordered[at - 1] + best) / 2, (best + ordered[at + 1]) / 2
    in_cell = norm.cdf(ends[1], best, sd) - norm.cdf(ends[0], best, sd)
    expected = 1 - (1 - in_cell) ** num_candidates
    assert abs(np.mean(nearest == best) - expected) < 4 * np.sqrt(expected * (1 - expected) / num)
    always_random = eqx.tree_at(lambda proposal: proposal.probability, proposal, number(1.0))
    uniform = np.asarray(propose(always_random))
    assert np.abs(np.mean(uniform)) < 4 / np.sqrt(3 * num)
    assert abs(np.mean(np.abs(uniform) < 0.5) - 0.5) < 4 * 0.5 / np.sqrt(num)


@pytest.mark.parametrize("name", by_tier(["pft", "pomcpow"], normal=["pft"]))
def test_the_first_action_of_the_root_is_that_of_the_policy_and_capacities_stop_widening(name):
    problem = drift()
    policy = lambda problem, key, belief: jnp.full((1,), 0.125)  # noqa: E731
    limited = planner(name, 200, first_action=policy, max_actions=2, max_branches=1, leaf_value=StateValue())
    tree = search(limited, problem, belief_of(problem))
    visits, actions = totals_by_action(tree)[..., 0], np.asarray(tree.parameters)[tree.children][..., 0]
    is_policys = (actions == 0.125) & (visits > 0.0)
    assert is_policys[ROOT, 0] and np.sum(is_policys) == 1
    assert visits.shape == (201, 2) and visits[ROOT].sum() == 200
    assert tree.branches.shape == (201, 1)


def test_rollouts_follow_their_policy_to_the_horizon_and_no_further():
    problem = eqx.tree_at(lambda problem: problem.end, drift(), number(1e9))
    still = Rollout(lambda problem, key, belief: -belief.states[0], num_rollouts=400)
    states, alive = jnp.asarray([[1.0], [1.0]]), jnp.asarray([True, True])
    for remaining in (0, 1, 3):
        value = eqx.filter_jit(still)(jax.random.key(0), problem, states, alive, jnp.asarray(remaining))
        # Every step ends at noise of variance 0.09, whose square is the loss.
        expected = -0.09 * sum(0.9**step for step in range(remaining))
        assert abs(float(value) - expected) <= 5 * 0.09 * np.sqrt(2 * remaining / 400)
