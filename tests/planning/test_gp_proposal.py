"""Proposals by a Gaussian process: statistics, posterior and choice against plain NumPy."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from bojax.acquisition.functions import ExpectedImprovement, UpperConfidenceBound
from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.models.kernels import RBF
from bojax.numerics.lanes import LANES
from bojax.planning.gp_proposal import GaussianProcessProposal
from bojax.planning.leaf_values import StateValue
from bojax.planning.proposals import RandomProposal, VoronoiProposal
from bojax.planning.tree import ROOT
from bojax.problems.actions import Mixed
from tests.planning.belief_searches import (
    belief_of,
    drift,
    number,
    planner,
    reference_tree,
    search,
    totals_by_action,
)

LENGTHSCALE, CORRELATION, NOISE = 0.6, 0.4, 0.02


def proposal(learns="return", acquisition=None, **changes):
    settings = {"num_initial": 2, "num_candidates": 64} | changes
    return GaussianProcessProposal(
        learns=learns,
        kernel=RBF(number(LENGTHSCALE)),
        level_correlation=number(CORRELATION),
        acquisition=UpperConfidenceBound(number(2.0)) if acquisition is None else acquisition,
        noise_variance=number(NOISE),
        **settings,
    )


class Watching(RandomProposal):
    """Random actions of a search that keeps the statistics of a target."""

    watched: str = eqx.field(static=True)

    @property
    def target(self):
        return self.watched


@pytest.mark.parametrize("name, target", [("pft", "return"), ("pomcpow", "reward")])
def test_statistics_are_those_of_all_visits(name, target):
    problem = drift()
    belief, search_planner = belief_of(problem), planner(name, 150, proposal=Watching(target))
    tree = jax.device_get(search(search_planner, jax.random.key(5), problem, belief))
    expected = reference_tree(search_planner, jax.random.key(5), problem, belief)
    nodes = [(ROOT, expected)]
    for node, b in nodes:
        for slot, action in enumerate(b.actions):
            values = np.array(action.returns if target == "return" else action.rewards)
            row = tree.totals[tree.children[node, slot]]
            np.testing.assert_allclose(row[0], len(values))
            np.testing.assert_allclose(row[1], sum(action.returns), rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(row[2], values.sum(), rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(row[3], len(values) * values.var(), rtol=1e-9, atol=1e-9)
            branches = tree.branches[tree.children[node, slot]]
            nodes += zip(branches.tolist(), action.branches, strict=False)
    assert sum(len(b.actions) for _, b in nodes) > 60


def covariance(a, b, space):
    """Of two actions' parameters, by the formula of an angle or of a plain number."""
    if isinstance(space, Mixed):
        angle = np.pi * (a[0] - b[0])
        same = (a[1] > 0.0) == (b[1] > 0.0)
        return np.exp(-2.0 * np.sin(angle / 2.0) ** 2 / LENGTHSCALE**2) * (1.0 if same else CORRELATION)
    return np.exp(-0.5 * np.sum((a - b) ** 2) / LENGTHSCALE**2)


def posterior(actions, totals, root_totals, points, space):
    """Mean and variance at points, in standardised units."""
    exists = totals[:, 0] > 0
    (n, _, sums, squares), actions = totals[exists].T, actions[exists]
    y = sums / n
    centre, spread = y.mean(), y.var()
    pooled = spread
    for each in (root_totals, totals):
        degrees = np.maximum(each[:, 0] - 1, 0).sum()
        if degrees >= 3:
            pooled = each[:, 3].sum() / degrees
    variances = (2.0 * pooled + squares) / (2.0 + n - 1.0) / n / spread + NOISE
    gram = np.array([[covariance(a, b, space) for b in actions] for a in actions])
    cross = np.array([[covariance(a, b, space) for b in actions] for a in points])
    solve = np.linalg.solve(
        gram + np.diag(variances), np.column_stack([(y - centre) / np.sqrt(spread), cross.T])
    )
    return cross @ solve[:, 0], 1.0 - np.einsum("ij,ji->i", cross, solve[:, 1:])


VDP = build(kinds("problem")["vdp-tag"]())


@pytest.mark.parametrize(
    "problem, name, learns",
    [(drift(), "ucb", "return"), (VDP, "ei", "reward")],
    ids=["box", "angle and level"],
)
def test_the_proposal_is_that_of_the_posterior(problem, name, learns):
    acquisition = {"ucb": UpperConfidenceBound(number(2.0)), "ei": ExpectedImprovement(number(0.0))}[name]
    rule = proposal(learns, acquisition)
    tree = search(planner("pft", 150, proposal=rule), jax.random.key(5), problem, belief_of(problem))
    space = problem.actions
    all_totals = totals_by_action(tree)
    visits = all_totals[..., 0]
    nodes = [ROOT, *np.argsort(-(visits[1:] > 0).sum(axis=1))[:2] + 1]
    for node in nodes:
        totals = all_totals[node]
        assert (totals[:, 0] > 0).sum() >= 3
        key, at = jax.random.key(9), jnp.asarray(node, jnp.int32)
        candidates = np.asarray(jax.vmap(space.sample)(jax.random.split(jnp.copy(key), 64)))
        actions = np.asarray(tree.parameters[tree.children[node]])
        root_totals = all_totals[ROOT]
        mean, variance = posterior(actions, totals, root_totals, candidates, space)
        exists = totals[:, 0] > 0
        incumbent = posterior(actions, totals, root_totals, actions[exists], space)[0].max()
        std = np.sqrt(variance)
        z = (mean - incumbent) / std
        score = mean + 2.0 * std if name == "ucb" else std * (norm.pdf(z) + z * norm.cdf(z))
        chosen = eqx.filter_jit(rule)(jnp.copy(key), space, tree, at, jnp.asarray(totals))
        np.testing.assert_allclose(chosen, candidates[np.argmax(score)])
        random = eqx.filter_jit(proposal(num_initial=50))(key, space, tree, at, jnp.asarray(totals))
        np.testing.assert_allclose(random, candidates[0])


@pytest.mark.slow
def test_it_finds_the_best_of_many_actions_sooner_than_random_ones():
    # An immediate reward that an action alone decides: 1 - (a - 0.37)^2, with noise of the belief.
    problem = eqx.tree_at(lambda p: p.end, drift(), number(1e9))
    belief = belief_of(problem, 400)
    belief = eqx.tree_at(lambda b: b.states, belief, belief.states * 0.05 - 0.6)

    def error(rule):
        search = planner("pft", 100, proposal=rule, depth=1, widening=(40.0, 0.01), exploration=0.5)
        plan = jax.vmap(lambda key: search.plan(key, problem, belief).action[0], axis_name="lanes")
        return np.abs(np.asarray(eqx.filter_jit(plan)(jax.random.split(jax.random.key(4), 24))) - 0.6).mean()

    assert error(proposal("reward")) < error(RandomProposal())


@pytest.mark.parametrize(
    "rule", [proposal(), VoronoiProposal(number(0.1), number([0.3]), number(0.0), 4)], ids=["gp", "voronoi"]
)
def test_no_iteration_copies_arrays_of_all_nodes(rule):
    """With copies, the time of a search grows with the square of its iterations."""
    problem, num_nodes = drift(), 312  # no other array has this length
    one = planner("pomcpow", num_nodes - 1, proposal=rule, leaf_value=StateValue())
    searches = jax.jit(
        jax.vmap(lambda key, belief: one.search(key, problem, belief), (0, None), axis_name=LANES)
    )
    keys = jax.random.split(jax.random.key(0), 2)
    program = searches.lower(keys, belief_of(problem)).compile().as_text()
    bodies = set(re.findall(r"body=%?([\w.-]+)", program))
    copied, name = [], ""
    for line in program.splitlines():
        if opened := re.match(r"(?:ENTRY )?%?([\w.-]+) \(.*\{$", line):
            name = opened[1]
        elif name in bodies and (copy := re.search(r" = (\S+) copy\(", line)) and f",{num_nodes}," in copy[1]:
            copied.append(copy[1])
    assert bodies and not copied
