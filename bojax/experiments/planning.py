"""A planning episode: plan, execute and observe until the task ends."""

from collections.abc import Mapping
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar
from typing_extensions import override

from bojax.experiments.base import Experiment, Records
from bojax.experiments.episode import where
from bojax.planning.base import Planner
from bojax.problems.base import Belief, Problem, Record, World
from bojax.results.schema import Table


class PlanningState(eqx.Module):
    """State of a planning episode."""

    key_world: Key[Array, ""]  # key of the world's random numbers
    # Key of the planner's random numbers, a separate stream, so that all planners face the same initial
    # states and the same noise
    key_planner: Key[Array, ""]
    world: World  # true state of the world
    belief: Belief  # belief of the planner
    step: Int[Array, ""]  # number of steps taken
    accumulated: Float[Array, ""]  # sum of the rewards so far
    # Discounted sum of the rewards so far; None if the problem has no discount
    discounted: Float[Array, ""] | None
    is_done: Bool[Array, ""]  # whether the episode has ended
    failed: Bool[Array, ""]  # whether the simulation has diverged
    record: Record  # what the problem records
    measured: dict[str, Float[Array, ""]]  # sums over the steps of what the planner measures of its plans


class PlanningEpisode(Experiment):
    """One episode of a planner on a problem; an advance is one plan and its execution.

    Settings: `bojax.experiments.settings.Planning`.
    """

    problem: Problem
    planner: Planner

    def __post_init__(self):
        """Let the planner compute what it needs only once for the problem."""
        self.planner = self.planner.prepared(self.problem)

    def __check_init__(self):
        """Refuse a planner that does not fit the problem, or raise ValueError."""
        self.planner.check(self.problem)

    @property
    @override
    def tables(self) -> Mapping[str, Table]:
        return {
            "runs": self.problem.run_columns + self.planner.run_columns,
            "steps": self.problem.step_columns,
        }

    @property
    @override
    def lanes_on_cpu(self) -> int:
        return self.problem.lanes_on_cpu

    @property
    @override
    def max_advances(self) -> int:
        return self.problem.max_steps

    @override
    def init(self, key: Key[Array, ""]) -> PlanningState:
        problem, num_samples = self.problem, self.planner.num_samples
        key_world, key_planner = jax.random.split(key)
        world = problem.reset(jax.random.fold_in(key_world, 0))
        sampled = problem.samples_belief
        key_prior = jax.random.fold_in(key_planner, 0) if sampled else jax.random.fold_in(key_world, 1)
        belief = problem.prior(key_prior, world, num_samples)
        zero = jnp.zeros((), jnp.result_type(*problem.row(world).values()))
        return PlanningState(
            key_world=key_world,
            key_planner=key_planner,
            world=world,
            belief=belief,
            step=jnp.zeros((), jnp.int32),
            accumulated=zero,
            discounted=None if problem.return_discount is None else zero,
            is_done=jnp.zeros((), bool),
            failed=jnp.zeros((), bool),
            record=problem.begin_record(world, belief, num_samples),
            measured={column.name: zero for column in self.planner.run_columns},
        )

    @override
    def advance(self, carry: PlanningState) -> tuple[PlanningState, Records]:
        # A finished lane advances with the others, since a branch would be computed in every lane;
        # `where` at the end keeps its old state, and its row is not valid.
        active, problem = ~carry.is_done, self.problem
        key_plan, key_execute, key_update = self._keys(carry)
        plan = self.planner.plan(key_plan, problem, carry.belief)
        world, observation, events = problem.execute(key_execute, carry.world, plan.action)
        # The task's own objective (None), whatever the planner maximises: returns of planners are comparable.
        # The belief is the one before the action, as in (3.2) and (4.11).
        reward = problem.reward(None, carry.belief, plan.action, events)
        belief = problem.update(carry.belief, plan.action, observation, key_update)
        failed = jnp.zeros((), bool) if events.failed is None else events.failed
        # A diverged step pays NaN and leaves the state unchanged. Where a simulation cannot diverge, there is
        # nothing to select.
        if events.failed is not None:
            reward = jnp.where(failed, jnp.nan, reward)
            world, belief = where(~failed, (world, belief), (carry.world, carry.belief))

        step = carry.step + 1
        done = events.terminated | failed | (step >= problem.max_steps)
        accumulated, discounted = carry.accumulated + reward, carry.discounted
        if discounted is not None and problem.return_discount is not None:
            discounted += problem.return_discount ** carry.step.astype(reward.dtype) * reward
        after = replace(
            carry,
            world=world,
            belief=belief,
            step=step,
            accumulated=accumulated,
            discounted=discounted,
            is_done=done,
            failed=failed,
            record=problem.record(carry.record, carry.step, plan.action, events, world, belief),
            measured={name: total + plan.measured[name] for name, total in carry.measured.items()},
        )
        row = {
            "step": step,
            "reward": reward,
            "planned_reward": plan.reward,
            "planned_value": plan.value,
            "accumulated_reward": accumulated,
            "done": done,
            **problem.step_row(plan.action, observation),
            **problem.row(world),
            **problem.belief_row(world, belief),
        }
        columns = {column.name: row[column.name][None] for column in problem.step_columns}
        records = Records({"steps": {**columns, "valid": active[None]}}, active.astype(jnp.int32))
        return where(active, after, carry), records

    @override
    def is_done(self, carry: PlanningState) -> Bool[Array, ""]:
        return carry.is_done

    @override
    def summary(self, carry: PlanningState) -> dict[str, Scalar]:
        sums = {"return": carry.accumulated, "discounted_return": carry.discounted, "steps": carry.step}
        values = sums | self.problem.summary(carry.record, carry.world, carry.belief)
        found = {column.name: values[column.name] for column in self.problem.run_columns}
        steps = jnp.maximum(carry.step, 1).astype(carry.accumulated.dtype)
        return found | {name: total / steps for name, total in carry.measured.items()}

    @override
    def snapshot(self, carry: PlanningState) -> dict[str, dict[str, Array]]:
        return self.problem.arrays(carry.record, carry.world, carry.belief)

    def _keys(self, carry: PlanningState) -> tuple[Key[Array, ""], Key[Array, ""], Key[Array, ""] | None]:
        """Keys to plan, to execute, and to update the belief: the next counters after those of `init`."""
        if not self.problem.samples_belief:
            key_execute = jax.random.fold_in(carry.key_world, carry.step + 2)
            return jax.random.fold_in(carry.key_planner, carry.step), key_execute, None
        key_execute = jax.random.fold_in(carry.key_world, carry.step + 1)
        key_plan, key_update = jax.random.split(jax.random.fold_in(carry.key_planner, carry.step + 1))
        return key_plan, key_execute, key_update
