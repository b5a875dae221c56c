"""An episode of a planner on a state problem: plan for a belief of particles, act, and filter."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar
from typing_extensions import override

from bojax.experiments.base import Experiment, Records
from bojax.experiments.planning import keep_finished
from bojax.planning.belief_search import BeliefPlanner, BeliefSearch
from bojax.planning.leaf_values import StateValue
from bojax.problems import particles
from bojax.problems.particles import Particles
from bojax.problems.pomdp import light_dark_filter
from bojax.problems.state_space import StateProblem
from bojax.results.schema import Column, Table

Update = Callable[..., tuple[Particles, Bool[Array, ""]]]
"""A filter, with the arguments and results of `particles.update`."""

UPDATES: Mapping[str, Update] = {"bootstrap": particles.update, "light-dark": light_dark_filter.update}


def _update_named(update: str | Update) -> Update:
    return UPDATES[update] if isinstance(update, str) else update


class BeliefState(eqx.Module):
    """State of an episode.

    Attributes:
        key_world: Key of the world's random numbers.
        key_planner: Key of the planner and its filter, a separate stream, so that all planners face the same
            initial states.
        state: True state of the world.
        belief: Belief of the planner.
        step: Number of actions taken.
        accumulated: Sum of the rewards so far.
        discounted: Discounted sum of the rewards so far.
        collapses: How often no particle explained an observation.
        is_done: Whether the episode has ended.
    """

    key_world: Key[Array, ""]
    key_planner: Key[Array, ""]
    state: Float[Array, "D"]
    belief: Particles
    step: Int[Array, ""]
    accumulated: Float[Array, ""]
    discounted: Float[Array, ""]
    collapses: Int[Array, ""]
    is_done: Bool[Array, ""]


class BeliefEpisode(Experiment):
    """One episode of a planner on a state problem; an advance is one plan and its action.

    Settings: `bojax.experiments.settings.BeliefPlanning`.
    """

    problem: StateProblem
    planner: BeliefPlanner
    num_particles: int = eqx.field(static=True)
    belief_update: Update = eqx.field(static=True, converter=_update_named)

    def __check_init__(self):
        """Refuse a planner that needs what the problem lacks, or raise ValueError."""
        key = jax.random.key(0)
        try:
            known = jax.eval_shape(lambda: self.problem.heuristic_value(self.problem.initial(key)))
            leaf_value = self.planner.leaf_value if isinstance(self.planner, BeliefSearch) else None
            if known is None and isinstance(leaf_value, StateValue):
                raise ValueError("planner.leaf_value: got state-value; the problem has no values of states")
            jax.eval_shape(self._plan, key, jax.eval_shape(self._prior, key))
        except (AttributeError, TypeError, IndexError) as error:
            raise ValueError(
                f"planner: does not fit the problem: {error}; allowed: policies and proposals for its actions"
            ) from error

    @property
    @override
    def tables(self) -> Mapping[str, Table]:
        state = tuple(Column(name, "float64", "", "true state") for name in self._names)
        return {"runs": _RUN_COLUMNS, "steps": _STEP_COLUMNS + state}

    @property
    @override
    def max_advances(self) -> int:
        return self.problem.max_steps

    @cached_property
    def _names(self) -> list[str]:
        size = jax.eval_shape(self.problem.initial, jax.random.key(0)).shape[0]
        return [f"state_{index}" for index in range(size)]

    def _prior(self, key: Key[Array, ""]) -> Particles:
        return particles.initial(self.problem, key, self.num_particles)

    def _plan(self, key: Key[Array, ""], belief: Particles):
        return self.planner.plan(key, self.problem, belief)

    @override
    def init(self, key: Key[Array, ""]) -> BeliefState:
        key_world, key_planner = jax.random.split(key)
        zero = jnp.zeros_like(self.problem.discount)
        return BeliefState(
            key_world=key_world,
            key_planner=key_planner,
            state=self.problem.initial(jax.random.fold_in(key_world, 0)),
            belief=self._prior(jax.random.fold_in(key_planner, 0)),
            step=jnp.zeros((), jnp.int32),
            accumulated=zero,
            discounted=zero,
            collapses=jnp.zeros((), jnp.int32),
            is_done=jnp.zeros((), bool),
        )

    @override
    def advance(self, carry: BeliefState) -> tuple[BeliefState, Records]:
        active, problem = ~carry.is_done, self.problem
        # Counter 0 of both streams was used by `init`.
        key_plan, key_filter = jax.random.split(jax.random.fold_in(carry.key_planner, carry.step + 1))
        key_step, key_observe = jax.random.split(jax.random.fold_in(carry.key_world, carry.step + 1))
        plan = self._plan(key_plan, carry.belief)
        state, reward, terminated = problem.step(key_step, carry.state, plan.action)
        observation = problem.observe(key_observe, carry.state, plan.action, state)
        belief, collapsed = self.belief_update(problem, key_filter, carry.belief, plan.action, observation)

        weight = problem.discount ** carry.step.astype(reward.dtype)
        step = carry.step + 1
        done = terminated | (step >= problem.max_steps)
        after = replace(
            carry,
            state=state,
            belief=belief,
            step=step,
            accumulated=carry.accumulated + reward,
            discounted=carry.discounted + weight * reward,
            collapses=carry.collapses + (collapsed & ~terminated).astype(jnp.int32),
            is_done=done,
        )
        row = {
            "step": step,
            "reward": reward,
            "planned_value": plan.value,
            "accumulated_reward": after.accumulated,
            "done": done,
            **dict(zip(self._names, state, strict=True)),
            "valid": active,
        }
        records = Records(
            tables={"steps": {name: value[None] for name, value in row.items()}},
            active_steps=active.astype(jnp.int32),
        )
        return keep_finished(active, after, carry), records

    @override
    def is_done(self, carry: BeliefState) -> Bool[Array, ""]:
        return carry.is_done

    @override
    def summary(self, carry: BeliefState) -> dict[str, Scalar]:
        return {
            "return": carry.accumulated,
            "discounted_return": carry.discounted,
            "steps": carry.step,
            "collapses": carry.collapses,
        }


_RUN_COLUMNS: Table = (
    Column("return", "float64", "", "sum of the rewards"),
    Column("discounted_return", "float64", "", "sum of the rewards, each discounted by its step"),
    Column("steps", "int32", "", "actions taken"),
    Column("collapses", "int32", "", "times that no particle of the belief explained the observation"),
)

_STEP_COLUMNS: Table = (
    Column("step", "int32", "", "number of the action, from 1"),
    Column("reward", "float64", "", "reward of the action"),
    Column(
        "planned_value",
        "float64",
        "",
        "discounted return that the planner expected of the action; null of a policy",
        nullable=True,
    ),
    Column("accumulated_reward", "float64", "", "sum of the rewards so far"),
    Column("done", "bool", "", "the episode ended with this action"),
)
