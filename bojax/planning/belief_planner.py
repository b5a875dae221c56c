"""Planners on beliefs of particles: their base class, and policies without search."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Key
from typing_extensions import override

from bojax.planning.base import Plan, Planner
from bojax.planning.leaf_values import Policy
from bojax.planning.oracles import policy_named
from bojax.problems.base import Problem
from bojax.problems.particles import Particles
from bojax.problems.state_space import StateProblem


class BeliefPlanner(Planner):
    """A planner on a belief of particles."""

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        if not isinstance(problem, StateProblem):
            name = type(problem).__name__
            raise ValueError(f"planner: {type(self).__name__} plans on particles, which {name} does not have")
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


class PolicyPlanner(BeliefPlanner):
    """A policy without search, which predicts no value.

    Attributes:
        policy: The policy, or its name in `bojax.planning.oracles`.
    """

    policy: Policy = eqx.field(static=True, converter=policy_named)

    @override
    def plan(self, key: Key[Array, ""], problem: StateProblem, belief: Particles) -> Plan:
        action = self.policy(problem, key, belief)
        return Plan(action, None, jnp.full_like(problem.discount, jnp.nan), jnp.zeros((), jnp.int32))
