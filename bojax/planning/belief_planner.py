"""Planners on beliefs of particles: their base class, and policies without search."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.models.checks import is_known
from bojax.planning.base import Plan, Planner
from bojax.planning.leaf_values import Policy
from bojax.planning.oracles import policy_named
from bojax.problems import particles
from bojax.problems.base import Problem
from bojax.problems.particles import Particles
from bojax.problems.state_checks import check_model
from bojax.problems.state_space import StateProblem

_NUM_PARTICLES = 100
"""Size of the belief on which the action of a policy is tried."""


class BeliefPlanner(Planner):
    """A planner on a belief of particles."""

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        if not isinstance(problem, StateProblem):
            name = type(problem).__name__
            raise ValueError(f"planner: {type(self).__name__} plans on particles, which {name} does not have")
        check_model(problem)
        try:
            jax.eval_shape(self._plan_once, problem)
        except (AttributeError, TypeError, IndexError) as error:
            raise ValueError(
                f"planner: does not fit the problem: {error}; allowed: policies and proposals for its actions"
            ) from error

    def _plan_once(self, problem: StateProblem) -> Plan:
        key_world, key_prior, key_plan = jax.random.split(jax.random.key(0), 3)
        belief = problem.prior(key_prior, problem.reset(key_world), self.num_samples)
        return self.plan(key_plan, problem, belief)


def check_policy(name: str, policy: Policy, problem: Problem) -> None:
    """Refuse a policy whose action for an initial belief is not one of the problem's, by a ValueError."""
    if not isinstance(problem, StateProblem) or not is_known(problem):
        return
    action, is_inside = _acted(policy, problem)
    if not is_inside:
        raise ValueError(
            f"{name}: its action for an initial belief is {np.asarray(action).tolist()}; allowed: actions of "
            "the problem"
        )


@eqx.filter_jit
def _acted(policy: Policy, problem: StateProblem) -> tuple[Float[Array, "K"], Bool[Array, ""]]:
    key_prior, key = jax.random.split(jax.random.key(0))
    action = policy(problem, key, particles.initial(problem, key_prior, _NUM_PARTICLES))
    return action, problem.actions.contains(action)


class PolicyPlanner(BeliefPlanner):
    """A policy without search, which predicts no value.

    Attributes:
        policy: The policy, or its name in `bojax.planning.oracles`.
    """

    policy: Policy = eqx.field(static=True, converter=policy_named)

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        check_policy("planner.policy", self.policy, problem)

    @override
    def plan(self, key: Key[Array, ""], problem: StateProblem, belief: Particles) -> Plan:
        action = self.policy(problem, key, belief)
        return Plan(action, None, jnp.full_like(problem.discount, jnp.nan), jnp.zeros((), jnp.int32))
