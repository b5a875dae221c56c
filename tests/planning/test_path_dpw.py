"""Path-dpw: branches of an action are other observations of the same path, and their mean return is exact."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.motions.base import ContinuousMotions, place, sample_by_arc_length
from bojax.planning.path_dpw import PathDPW
from bojax.planning.proposals import RandomProposal
from bojax.planning.tree import ROOT
from bojax.planning.widening import Widening
from tests.planning.belief_searches import RECOMMENDATION, totals_by_action
from tests.planning.samples import cubic_curves, f64, field_belief, monitoring
from tests.tiers import by_tier

OPEN = {"walls": None, "target_area": None, "domain": (0.0, 0.0, 6.0, 6.0)}
NUM_SAMPLES = 6


class Straight(ContinuousMotions):
    """The same path whatever the parameters."""

    length: jax.Array
    num_samples: int = eqx.field(static=True)

    @property
    def num_params(self):
        return 1

    def path(self, params):
        return sample_by_arc_length(lambda u: jnp.stack([u, 0.0 * u]), self.length, self.num_samples)


def path_dpw(motions=None, widening=(1.0, 1.0), iterations=40, **settings):
    settings = {"depth": 3, "max_actions": 8, "max_branches": 8, "num_rollout_paths": 16} | settings
    return PathDPW(
        motions=motions or cubic_curves(),
        exploration=f64(10.0),
        action_widening=Widening(f64(3.0), f64(0.3)),
        observation_widening=Widening(*map(f64, widening)),
        proposal=RandomProposal(),
        recommendation=RECOMMENDATION("value"),
        discount=f64(0.9),
        iterations=iterations,
        **settings,
    )


@eqx.filter_jit
def search(planner, key, problem, belief):
    key_paths, key_search = jax.random.split(key)
    return planner.search(key_search, planner.model(key_paths, problem, belief), belief)


def seen(problem):
    return field_belief(problem, (2.5, 3.0, 0.3), 12, NUM_SAMPLES)


def test_branches_are_other_observations_of_one_path():
    problem = monitoring(**OPEN)
    belief = seen(problem)
    tree = search(path_dpw(max_actions=2), jax.random.key(0), problem, belief)
    path_of = jax.jit(lambda parameters: place(cubic_curves().path(parameters), belief.pose))
    for slot in range(2):
        action = int(tree.children[ROOT, slot])
        branches = np.asarray(tree.branches[action])
        nodes = jax.tree.map(lambda leaf, at=branches[branches > 0]: leaf[at], tree.beliefs)
        assert len(nodes.rows) >= 4
        path = path_of(tree.parameters[action])
        first = slice(0, NUM_SAMPLES)  # samples of the first path; the others are of later ones
        for points in nodes.points[:, first]:
            np.testing.assert_allclose(points, path[:, :2], atol=1e-12)
        assert len(np.unique(nodes.innovations[:, 0])) == len(nodes.rows)
        np.testing.assert_allclose(tree.outcome[branches[branches > 0], 0], tree.outcome[branches[0], 0])


WIDENINGS = ((1.0, 1.0), 40), ((1.0, 0.3), 3), ((1.0, 0.5), 1)
"""Widening of observations, and the number of branches that it comes to."""


@pytest.mark.parametrize("widening_and_branches", by_tier(WIDENINGS, normal=WIDENINGS[1:2]))
def test_the_value_of_one_path_is_its_expectation(widening_and_branches):
    widening, num_branches = widening_and_branches
    # One path alone: its rewards are linear in the posterior mean, whose expectation over imagined samples is
    # the mean before them. So the value without samples, of the predictive mean, is the expectation.
    motions = Straight(f64(0.8), NUM_SAMPLES)
    settings = {"max_actions": 1, "max_branches": num_branches, "num_rollout_paths": 1}
    planner = path_dpw(motions, widening, **settings)

    def values(imagined):
        problem = monitoring(imagined=imagined, **OPEN)
        belief = seen(problem)
        of_key = lambda key: planner.plan(key, problem, belief).value  # noqa: E731
        return np.asarray(eqx.filter_jit(jax.vmap(of_key))(jax.random.split(jax.random.key(1), 60)))

    found, exact = values("sample"), values("mean")
    np.testing.assert_allclose(exact, exact[0], rtol=1e-9)
    error = found.std(ddof=1) / len(found) ** 0.5
    assert error > 0.0 and abs(found.mean() - exact[0]) < 4.0 * error


def test_the_plan_of_one_action_is_the_path_of_the_highest_reward():
    problem = monitoring(**OPEN)
    belief = seen(problem)
    planner = path_dpw(depth=1, iterations=30, max_actions=20)
    plan = eqx.filter_jit(planner.plan)(jax.random.key(2), problem, belief)
    tree = search(planner, jax.random.key(2), problem, belief)
    actions = np.flatnonzero(totals_by_action(tree)[ROOT, :, 0])
    assert len(actions) > 5
    world = problem.reset(jax.random.key(0))
    world = eqx.tree_at(lambda world: world.vehicle, world, belief.pose)

    @jax.jit
    def paid(parameters):
        path = planner.motions.path(parameters)
        *_, events = problem.execute(jax.random.key(0), world, path)
        return problem.reward(None, belief, path, events)

    rewards = [float(paid(tree.parameters[tree.children[ROOT, slot]])) for slot in actions]
    assert float(plan.value) == pytest.approx(max(rewards))
    assert float(plan.reward) == pytest.approx(max(rewards))
