"""A planning episode: plan, execute and observe until the task ends."""

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar
from typing_extensions import override

from bojax.experiments.base import Experiment, Records
from bojax.motions.base import tightest_radius
from bojax.planning.base import Planner
from bojax.problems.base import POSE_COLUMNS, Belief, Problem, World
from bojax.results.schema import Column, Table


class PlanningState(eqx.Module):
    """State of a planning episode.

    Attributes:
        key_world: Key of the world's random numbers.
        key_planner: Key of the planner's random numbers, a separate stream, so that all planners face the
            same initial states and the same noise.
        world: True state of the world.
        belief: Belief of the planner.
        step: Number of steps taken.
        accumulated: Sum of the rewards so far.
        success: Whether the task has been solved.
        exited: Number of times that the robot has left the domain.
        is_done: Whether the episode has ended.
        failed: Whether the simulation has diverged.
        start: Initial pose.
        paths: Poses driven, in the world frame; NaN for steps not taken.
        plans: Planned paths, in the robot's frame; NaN for steps not taken.
        frames: Frames of an animation, see `Events`; NaN for steps not taken.
    """

    key_world: Key[Array, ""]
    key_planner: Key[Array, ""]
    world: World
    belief: Belief
    step: Int[Array, ""]
    accumulated: Float[Array, ""]
    success: Bool[Array, ""]
    exited: Int[Array, ""]
    is_done: Bool[Array, ""]
    failed: Bool[Array, ""]
    start: Float[Array, "3"]
    paths: Float[Array, "T S 3"]
    plans: Float[Array, "T S 3"]
    frames: Float[Array, "T F Q"] | None


class PlanningEpisode(Experiment):
    """One episode of a planner on a problem; an advance is one plan and its execution.

    Settings: `bojax.experiments.settings.Planning`.
    """

    problem: Problem
    planner: Planner

    def __check_init__(self):
        """Compare the trajectories of the planner with the abilities of the robot, or raise ValueError."""
        reach = self.problem.reach
        if isfinite(reach) and (length := float(self.planner.motions.length)) > reach:
            raise ValueError(
                f"planner.motions.length: got {length:g}; allowed: <= {reach:.2f}, the longest path that the "
                "robot completes: set a shorter length, or more time per path"
            )
        radius = self.problem.turning_radius
        if radius == 0.0:
            return
        tightest = tightest_radius(self.planner.motions)
        if tightest < radius:
            raise ValueError(
                f"planner.motions: the tightest trajectory has a radius of {tightest:.2f} m; allowed: >= "
                f"{radius:.2f} m, the turning radius of the robot: set longer trajectories or smaller angles"
            )

    @property
    @override
    def tables(self) -> Mapping[str, Table]:
        return {"runs": _RUN_COLUMNS + self.problem.scores, "steps": _STEP_COLUMNS + POSE_COLUMNS}

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
        key_world, key_planner = jax.random.split(key)
        world = self.problem.reset(jax.random.fold_in(key_world, 0))
        start = self.problem.pose(world)
        num_samples = self.planner.motions.num_samples
        path = jax.ShapeDtypeStruct((num_samples, 3), start.dtype)
        # The problem is an argument, since arrays that a closure captures may be tracers.
        _, _, events = eqx.filter_eval_shape(type(self.problem).execute, self.problem, key, world, path)
        return PlanningState(
            key_world=key_world,
            key_planner=key_planner,
            world=world,
            belief=self.problem.prior(jax.random.fold_in(key_world, 1), world, num_samples),
            step=jnp.zeros((), jnp.int32),
            accumulated=jnp.zeros((), start.dtype),
            success=jnp.zeros((), bool),
            exited=jnp.zeros((), jnp.int32),
            is_done=jnp.zeros((), bool),
            failed=jnp.zeros((), bool),
            start=start,
            paths=jnp.full((self.problem.max_steps, num_samples, 3), jnp.nan, start.dtype),
            plans=jnp.full((self.problem.max_steps, num_samples, 3), jnp.nan, start.dtype),
            frames=None
            if events.frames is None
            else jnp.full((self.problem.max_steps, *events.frames.shape), jnp.nan, events.frames.dtype),
        )

    @override
    def advance(self, carry: PlanningState) -> tuple[PlanningState, Records]:
        # A finished lane advances with the others, since a branch would be computed in every lane;
        # `keep_finished` at the end keeps its old state, and its row is not valid.
        active = ~carry.is_done
        key = jax.random.fold_in(carry.key_planner, carry.step)
        plan = self.planner.plan(key, self.problem, carry.belief)
        # Counters 0 and 1 of the world's stream were used by `init`.
        key = jax.random.fold_in(carry.key_world, carry.step + 2)
        world, observation, events = self.problem.execute(key, carry.world, plan.path)
        # The task's own objective (None), whatever the planner maximises: returns of planners are comparable.
        # The belief is the one before the path, as in (3.2) and (4.11).
        reward = self.problem.reward(None, carry.belief, plan.path, events)
        belief = self.problem.update(carry.belief, plan.path, observation)
        failed = jnp.zeros((), bool) if events.failed is None else events.failed
        success, exited = events.success & ~failed, events.exited & ~failed
        # A diverged step pays NaN and leaves the state unchanged. Where a simulation cannot diverge, there is
        # nothing to select.
        if events.failed is not None:
            reward = jnp.where(failed, jnp.nan, reward)
            world, belief = keep_finished(~failed, (world, belief), (carry.world, carry.belief))

        step = carry.step + 1
        done = events.terminated | failed | (step >= self.problem.max_steps)
        accumulated = carry.accumulated + reward
        after = replace(
            carry,
            world=world,
            belief=belief,
            step=step,
            accumulated=accumulated,
            success=carry.success | success,
            exited=carry.exited + exited.astype(jnp.int32),
            is_done=done,
            failed=failed,
            paths=carry.paths.at[carry.step].set(events.driven),
            plans=carry.plans.at[carry.step].set(plan.path),
            frames=None if carry.frames is None else carry.frames.at[carry.step].set(events.frames),
        )
        pose = self.problem.pose(world)
        row = {
            "step": step,
            "reward": reward,
            "planned_reward": plan.reward,
            "accumulated_reward": accumulated,
            "done": done,
            "x": pose[0],
            "y": pose[1],
            "heading": pose[2],
            "valid": active,
        }
        records = Records(
            tables={"steps": {name: value[None] for name, value in row.items()}},
            active_steps=active.astype(jnp.int32),
        )
        return keep_finished(active, after, carry), records

    @override
    def is_done(self, carry: PlanningState) -> Bool[Array, ""]:
        return carry.is_done

    @override
    def summary(self, carry: PlanningState) -> dict[str, Scalar]:
        counts = {"steps": carry.step, "exits": carry.exited}
        scores = self.problem.score(carry.world, carry.belief)
        return {"return": carry.accumulated, "success": carry.success, **counts, **scores}

    @override
    def snapshot(self, carry: PlanningState) -> dict[str, dict[str, Array]]:
        """The planned and driven paths, and the arrays of the problem, for figures and animations."""
        paths = {"paths": carry.paths, "plans": carry.plans, "start": carry.start}
        if carry.frames is not None:
            paths |= {"frames": carry.frames}
        return {"paths": paths, **self.problem.snapshot(carry.world, carry.belief)}


T = TypeVar("T")


def keep_finished(active: Bool[Array, ""], after: T, before: T) -> T:
    """The new state where a lane is active, the old one where it has finished."""
    # Leaves that an advance does not change are not selected: a select would use a key twice.
    return jax.tree.map(lambda a, b: a if a is b else jnp.where(active, a, b), after, before)


_RUN_COLUMNS: Table = (
    Column("return", "float64", "", "sum of the task's rewards"),
    Column("success", "bool", "", "the task was solved"),
    Column("steps", "int32", "", "actions taken"),
    Column("exits", "int32", "", "times that the robot left the domain"),
)

_STEP_COLUMNS: Table = (
    Column("step", "int32", "", "number of the action, from 1"),
    Column("reward", "float64", "", "the task's reward"),
    Column("planned_reward", "float64", "", "reward that the planner expected of the action"),
    Column("accumulated_reward", "float64", "", "sum of the task's rewards so far"),
    Column("done", "bool", "", "the episode ended with this action"),
)
