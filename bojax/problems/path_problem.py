"""Problems whose actions are paths of a robot on a plane."""

import abc
from dataclasses import replace
from math import isfinite
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar
from typing_extensions import override

from bojax.motions.base import Motions, Path, Pose, tightest_radius
from bojax.problems.base import (
    ACCUMULATED_REWARD,
    DONE,
    PLANNED_REWARD,
    RETURN,
    REWARD,
    STEP,
    STEPS,
    Belief,
    Events,
    Objective,
    Problem,
    World,
)
from bojax.results.schema import Column, Table

Node = Any
"""Belief at a node of the search tree: a tree of arrays that the search stores for every node."""

Root = Any
"""Data shared by all nodes of a plan, computed once per plan, such as the factored posterior of a field."""


class PathEvents(Events):
    """Outcome of the execution of a path in the world, with the fields of `Events`.

    Attributes:
        success: Whether the task is solved.
        exited: Whether the robot left the domain.
        driven: Poses of the robot in the world frame; past the pose at which it stopped, that pose is
            repeated.
        is_driven: Whether the robot reached each pose of the path.
        frames: Generalised positions during the motion, for an animation; None if there is nothing to
            animate.
    """

    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    success: Bool[Array, ""]
    exited: Bool[Array, ""]
    driven: Float[Array, "S 3"]
    is_driven: Bool[Array, "S"]
    frames: Float[Array, "F Q"] | None = None
    failed: Bool[Array, ""] | None = None


class PathRecord(eqx.Module):
    """Record of an episode.

    Attributes:
        success: Whether the task has been solved.
        exited: Number of times that the robot has left the domain.
        start: Initial pose.
        paths: Poses driven, in the world frame; NaN for steps not taken.
        plans: Planned paths, in the robot's frame; NaN for steps not taken.
        frames: Frames of an animation, see `PathEvents`; NaN for steps not taken.
    """

    success: Bool[Array, ""]
    exited: Int[Array, ""]
    start: Float[Array, "3"]
    paths: Float[Array, "T S 3"]
    plans: Float[Array, "T S 3"]
    frames: Float[Array, "T F Q"] | None


class Simulation(eqx.Module):
    """Result of simulating an action sequence from a node of the search tree.

    Attributes:
        node: Belief after the first action.
        rewards: Reward of each action.
        terminated: Whether the episode ends with each action; later actions are ignored.
    """

    node: Node
    rewards: Float[Array, "H"]
    terminated: Bool[Array, "H"]


class PathProblem(Problem):
    """A planning problem with paths of a robot as actions.

    Paths are given in the robot's frame; the problem transforms them to the world frame. A planner decodes
    them from the parameters of a family of motions. `simulate` takes a whole action sequence, so that a
    problem can evaluate a node and its rollout at once.

    Attributes:
        scores: Columns of `runs.parquet` that `score` computes.
    """

    scores: ClassVar[Table] = ()

    def with_objective(self, objective: Objective) -> "PathProblem":
        """The problem with what `root` prepares for the objective of a planner; itself by default."""
        return self

    @abc.abstractmethod
    def root(self, belief: Belief, horizon: int) -> tuple[Root, Node]:
        """The data shared by the nodes of a plan, and the root node."""

    @abc.abstractmethod
    def simulate(
        self, key: Key[Array, ""], root: Root, node: Node, paths: Float[Array, "H S 3"], objective: Objective
    ) -> Simulation:
        """Simulate an action sequence from a node of the search tree."""

    @abc.abstractmethod
    def pose(self, world: World) -> Pose:
        """True pose of the robot."""

    @property
    def turning_radius(self) -> float:
        """Smallest radius of a curve that the robot can follow, in metres."""
        return 0.0

    @property
    def reach(self) -> float:
        """Length of the longest path that the robot can complete, in metres."""
        return float("inf")

    def check_motions(self, motions: Motions) -> None:
        """Compare the trajectories of a planner with the abilities of the robot, or raise ValueError."""
        reach = self.reach
        if isfinite(reach) and (length := float(motions.length)) > reach:
            raise ValueError(
                f"planner.motions.length: got {length:g}; allowed: <= {reach:.2f}, the longest path that the "
                "robot completes: set a shorter length, or more time per path"
            )
        radius = self.turning_radius
        if radius > 0.0 and (tightest := tightest_radius(motions)) < radius:
            raise ValueError(
                f"planner.motions: the tightest trajectory has a radius of {tightest:.2f} m; allowed: >= "
                f"{radius:.2f} m, the turning radius of the robot: set longer trajectories or smaller angles"
            )

    def score(self, world: World, belief: Belief) -> dict[str, Scalar]:
        """Scores of the final belief, one per column of `scores`."""
        return {}

    def snapshot(self, world: World, belief: Belief) -> dict[str, dict[str, Array]]:
        """Arrays of the final belief, beside the paths: `{name: {array name: array}}`."""
        return {}

    @property
    @override
    def run_columns(self) -> Table:
        return (RETURN, _SUCCESS, STEPS, _EXITS, *self.scores)

    @property
    @override
    def step_columns(self) -> Table:
        return (STEP, REWARD, PLANNED_REWARD, ACCUMULATED_REWARD, DONE, *_POSE_COLUMNS)

    @override
    def row(self, world: World) -> dict[str, Scalar]:
        pose = self.pose(world)
        return {"x": pose[0], "y": pose[1], "heading": pose[2]}

    @override
    def summary(self, record: PathRecord, world: World, belief: Belief) -> dict[str, Scalar]:
        return {"success": record.success, "exits": record.exited, **self.score(world, belief)}

    @override
    def begin_record(self, world: World, belief: Belief, num_samples: int) -> PathRecord:
        start = self.pose(world)

        def not_taken(*shape: int) -> Float[Array, "..."]:
            return jnp.full((self.max_steps, *shape), jnp.nan, start.dtype)

        path = jax.ShapeDtypeStruct((num_samples, 3), start.dtype)
        key = eqx.filter_eval_shape(jax.random.key, 0)
        # The problem is an argument, since arrays that a closure captures may be tracers.
        _, _, events = eqx.filter_eval_shape(type(self).execute, self, key, world, path)
        return PathRecord(
            success=jnp.zeros((), bool),
            exited=jnp.zeros((), jnp.int32),
            start=start,
            paths=not_taken(num_samples, 3),
            plans=not_taken(num_samples, 3),
            frames=None
            if events.frames is None
            else jnp.full((self.max_steps, *events.frames.shape), jnp.nan, events.frames.dtype),
        )

    @override
    def record(
        self,
        record: PathRecord,
        step: Int[Array, ""],
        action: Path,
        events: PathEvents,
        world: World,
        belief: Belief,
    ) -> PathRecord:
        failed = jnp.zeros((), bool) if events.failed is None else events.failed
        return replace(
            record,
            success=record.success | (events.success & ~failed),
            exited=record.exited + (events.exited & ~failed).astype(jnp.int32),
            paths=record.paths.at[step].set(events.driven),
            plans=record.plans.at[step].set(action),
            frames=None if record.frames is None else record.frames.at[step].set(events.frames),
        )

    @override
    def arrays(self, record: PathRecord, world: World, belief: Belief) -> dict[str, dict[str, Array]]:
        """The planned and driven paths, and the arrays of the problem, for figures and animations."""
        paths = {"paths": record.paths, "plans": record.plans, "start": record.start}
        if record.frames is not None:
            paths |= {"frames": record.frames}
        return {"paths": paths, **self.snapshot(world, belief)}


_SUCCESS = Column("success", "bool", "", "the task was solved")
_EXITS = Column("exits", "int32", "", "times that the robot left the domain")
_POSE_COLUMNS: Table = (
    Column("x", "float64", "m", "true position after the step"),
    Column("y", "float64", "m", "true position after the step"),
    Column("heading", "float64", "rad", "true heading after the step, in [0, 2 pi)"),
)
