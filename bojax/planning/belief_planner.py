"""Planners on beliefs of particles: their base class, tree searches, and policies without search."""

import abc
import functools
from contextlib import nullcontext

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Num
from typing_extensions import override

from bojax.models.checks import is_known
from bojax.numerics.lanes import TREES
from bojax.numerics.trial import Misfit, computed, described, is_users, require, shapes, trial_of
from bojax.planning.base import Plan, Planner
from bojax.planning.belief_search import BeliefTreeSearch
from bojax.planning.leaf_values import LeafValue, ParticleSet, Policy
from bojax.planning.oracles import policy_named
from bojax.planning.root_parallel import recommended_by_all
from bojax.planning.tree import Index, Tree
from bojax.problems.actions import Discrete
from bojax.problems.base import Problem
from bojax.problems.particles import Particles
from bojax.problems.state_checks import check_model
from bojax.problems.state_model import Action, State
from bojax.problems.state_space import StateProblem


class BeliefPlanner(Planner):
    """A planner on a belief of particles."""

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        if not isinstance(problem, StateProblem):
            name = type(problem).__name__
            raise ValueError(f"planner: {type(self).__name__} plans on particles, which {name} does not have")
        check_model(problem)
        name = f"planner: {type(self).__name__}"
        try:
            with trial_of(name) if is_users(self) else nullcontext():
                _plan_once(shapes(self), shapes(problem))
        except (AttributeError, TypeError, IndexError, Misfit) as error:
            reason = str(error)
            if isinstance(error, AttributeError) and isinstance(error.obj, StateProblem):
                reason = f"{type(problem).__name__} has no `{error.name}`, which a policy or proposal needs"
            raise ValueError(
                f"planner: does not fit the problem: {reason}; "
                "allowed: policies and proposals for its actions"
            ) from error
        if is_users(self):
            _check_action(name, self, problem)


@functools.lru_cache
def _plan_once(planner: BeliefPlanner, problem: StateProblem) -> None:
    """Trace a plan; arrays are given by their shapes, so that points of a sweep share the trace."""

    def check(planner: BeliefPlanner, problem: StateProblem) -> None:
        key_plan, key_action = jax.random.split(jax.random.key(0))
        plan = _first_plan(planner, problem, key_plan)
        if not isinstance(plan, Plan):
            raise Misfit(f"plan returns {described(plan)}; allowed: a Plan")
        action = problem.actions.decode(problem.actions.sample(key_action))
        require("Plan.action", plan.action, action)
        require("Plan.value", plan.value, problem.discount)
        require("Plan.visits", plan.visits, jnp.zeros((), jnp.int32))

    eqx.filter_eval_shape(check, planner, problem)


def _first_plan(planner: BeliefPlanner, problem: StateProblem, key: Key[Array, ""]) -> Plan:
    key_world, key_prior, key_plan = jax.random.split(key, 3)
    return planner.plan(
        key_plan, problem, problem.prior(key_prior, problem.reset(key_world), planner.num_samples)
    )


def _check_action(name: str, planner: BeliefPlanner, problem: Problem) -> None:
    """Refuse a planner that is not pure or whose first action is outside of the space, by a ValueError."""
    if not isinstance(problem, StateProblem) or not is_known((planner, problem)):
        return
    with trial_of(name):
        action, is_inside = computed(_acted, planner, problem)
        if not is_inside:
            raise Misfit(
                f"its action for an initial belief is {action.tolist()}; allowed: actions of the problem"
            )


def _acted(
    planner: BeliefPlanner, problem: StateProblem, key: Key[Array, ""]
) -> tuple[Action, Bool[Array, ""]]:
    action = _first_plan(planner, problem, key).action
    return action, problem.actions.contains(action)


class PolicyPlanner(BeliefPlanner):
    """A policy without search, which predicts no value."""

    # The policy, or its name in `bojax.planning.oracles`
    policy: Policy = eqx.field(static=True, converter=policy_named)

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        _check_action("planner.policy", self, problem)

    @override
    def plan(self, key: Key[Array, ""], problem: StateProblem, belief: Particles) -> Plan:
        action = self.policy(problem, key, belief)
        return Plan(action, None, jnp.full_like(problem.discount, jnp.nan), jnp.zeros((), jnp.int32))


class BeliefSearch(BeliefTreeSearch, BeliefPlanner):
    """A planner that searches a tree of beliefs about the state of a `StateProblem`."""

    leaf_value: LeafValue  # estimate of the value of a new belief
    # Policy that gives the first action of the root, in a space that is not discrete; None to propose it as
    # the others
    first_action: Policy | None = eqx.field(static=True, converter=policy_named)
    # Number of independent trees of a plan, each of `iterations` simulations
    trees: int = eqx.field(static=True)
    # Distance at which actions of different trees are alike, see `recommended_by_all`
    merge_lengthscale: Float[Array, ""]

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        if self.first_action is not None:
            if isinstance(problem, StateProblem) and isinstance(problem.actions, Discrete):
                raise ValueError(
                    "planner.first_action: got a policy; allowed: null, since all actions of a list are tried"
                )
            _check_action("planner.first_action", PolicyPlanner(self.first_action), problem)

    @override
    def plan(self, key: Key[Array, ""], problem: StateProblem, belief: Particles) -> Plan:
        if self.trees == 1:
            best = self.search(key, problem, belief).root_actions().recommended(self.by_value)
        else:
            # The loops of all trees end together, like the loops of all lanes.
            search = jax.vmap(lambda key: self.search(key, problem, belief).root_actions(), axis_name=TREES)
            roots = search(jax.random.split(key, self.trees))
            best = recommended_by_all(problem.actions, roots, self.merge_lengthscale, self.by_value)
        action = problem.actions.decode(best.parameters)
        return Plan(action, None, best.value, best.visits.astype(jnp.int32))

    @override
    def states(self, key: Key[Array, ""], belief: Particles) -> Float[Array, "N D"]:
        return draw_states(key, belief, self.iterations)

    @override
    def first(self, key: Key[Array, ""], problem: StateProblem, belief: Particles) -> Num[Array, "P"] | None:
        if self.first_action is None:
            return None
        return problem.actions.encode(self.first_action(problem, key, belief))

    @abc.abstractmethod
    @override
    def leaf_at(self, tree: Tree, state: State, node: Index) -> ParticleSet:
        """States to estimate a leaf value from at `node`, where the horizon is reached."""

    @override
    def value_of(
        self, key: Key[Array, ""], problem: StateProblem, leaf: ParticleSet, remaining: Int[Array, ""]
    ) -> Float[Array, ""]:
        return self.leaf_value(key, problem, leaf.states, leaf.alive, remaining)


def draw_states(key: Key[Array, ""], belief: Particles, number: int) -> Float[Array, "N D"]:
    """Independent states of a belief, drawn by weight among those that are not terminal."""
    log_weights = jnp.where(belief.terminal, -jnp.inf, belief.log_weights)
    largest = jnp.max(log_weights)
    # A belief without a weight, or with terminal states only, has no state to draw: any will do.
    weights = jnp.where(jnp.isfinite(largest), jnp.exp(log_weights - largest), 1.0)
    ends = jnp.cumsum(weights)
    at = jax.random.uniform(key, (number,), ends.dtype) * ends[-1]
    indices = jnp.searchsorted(ends, at, side="right")
    return belief.states[jnp.minimum(indices, jnp.searchsorted(ends, ends[-1]))]
