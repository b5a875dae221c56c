"""The protocol between a problem, the planners that plan on it, and the experiment that plays it."""

import abc
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Array, Bool, Float, Key, Scalar

from bojax.motions.base import Path, Pose
from bojax.results.outline import Outline
from bojax.results.schema import Column, Table

World = Any
"""The true state."""

Belief = Any
"""What the planner knows."""

Node = Any
"""A belief inside the search tree: a tree of arrays that the search stores for every node."""

Root = Any
"""What all nodes of one plan share, computed once a plan (the factored posterior of a field, say)."""

Observation = Any

Objective = Any
"""What a planner maximises, if not the problem's own task: `None` stands for the task."""


class Events(eqx.Module):
    """What happened while the world executed a path.

    Attributes:
        reward: The task's reward, if the world pays it; what a belief pays, `Problem.reward` adds.
        terminated: The episode is over.
        success: The task is solved.
        exited: The robot left the domain.
        driven: Poses that the robot went through, in the world's frame.
        is_driven: Whether the robot reached that pose of the path; where it stopped before, `driven`
            repeats the pose that it stopped at.
        frames: Generalised positions along the way, for an animation; None where there is nothing to draw.
        failed: The simulation of the world has diverged, and the run with it; None where it cannot.
    """

    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    success: Bool[Array, ""]
    exited: Bool[Array, ""]
    driven: Float[Array, "S 3"]
    is_driven: Bool[Array, "S"]
    frames: Float[Array, "F Q"] | None = None
    failed: Bool[Array, ""] | None = None


class Simulation(eqx.Module):
    """An action sequence played on a belief of the tree.

    Attributes:
        node: The belief after the first action.
        rewards: Reward of each action.
        terminated: Whether the episode ended with each action; what follows does not count.
    """

    node: Node
    rewards: Float[Array, "H"]
    terminated: Bool[Array, "H"]


class Problem(eqx.Module):
    """A partially observable planning problem of a robot that drives paths.

    A path is always in the robot's frame; the problem places it. `simulate` takes a whole action
    sequence, so that a problem can do a node and its rollout in one shot.

    Attributes:
        max_steps: Actions an episode.
        scores: The columns that `score` adds to a run.
    """

    max_steps: eqx.AbstractVar[int]
    scores: ClassVar[Table] = ()

    @abc.abstractmethod
    def reset(self, key: Key[Array, ""]) -> World:
        """A start of an episode."""

    @abc.abstractmethod
    def prior(self, key: Key[Array, ""], world: World, num_samples: int) -> Belief:
        """What the planner knows at the start; a path brings at most `num_samples` observations."""

    @abc.abstractmethod
    def execute(self, key: Key[Array, ""], world: World, path: Path) -> tuple[World, Observation, Events]:
        """Drive a path in the world."""

    @abc.abstractmethod
    def update(self, belief: Belief, path: Path, observation: Observation) -> Belief:
        """The belief after an observation."""

    @abc.abstractmethod
    def reward(self, objective: Objective, belief: Belief, path: Path, events: Events) -> Scalar:
        """Reward of a path executed from `belief`, the belief before it."""

    @abc.abstractmethod
    def root(self, belief: Belief, horizon: int) -> tuple[Root, Node]:
        """What the nodes of a plan share, and the root node."""

    @abc.abstractmethod
    def simulate(
        self,
        key: Key[Array, ""],
        root: Root,
        node: Node,
        paths: Float[Array, "H S 3"],
        objective: Objective,
    ) -> Simulation:
        """Play an action sequence on a belief of the tree."""

    @abc.abstractmethod
    def pose(self, world: World) -> Pose:
        """The robot's true pose."""

    def outline(self) -> Outline | None:
        """What figures and films draw of the world; None where they know it, or draw nothing."""
        return None

    @property
    def lanes_on_cpu(self) -> int:
        """Most lanes per device of a CPU where the config says nothing, see `Experiment`.

        Measured on one core with 200 runs of SBO on the parking problem: 2,400 steps/s at 50 lanes, 1,500
        to 1,800 at 100 and 200, 1,600 at 4. Many lanes leave the cache, and wait longer for the slowest.
        """
        return 64

    @property
    def turning_radius(self) -> float:
        """Radius of the tightest curve that the robot can drive, in metres."""
        return 0.0

    @property
    def reach(self) -> float:
        """Length of the longest path that the robot can follow to its end, in metres."""
        return float("inf")

    def snapshot(self, world: World, belief: Belief) -> dict[str, dict[str, Array]]:
        """Arrays worth keeping of the end of an episode: `{name: {array name: array}}`."""
        del world, belief
        return {}

    def score(self, world: World, belief: Belief) -> dict[str, Scalar]:
        """How good the final belief is: the values of `scores`."""
        del world, belief
        return {}


POSE_COLUMNS: Table = (
    Column("x", "float64", "m", "true position after the step"),
    Column("y", "float64", "m", "true position after the step"),
    Column("heading", "float64", "rad", "true heading after the step, in [0, 2 pi)"),
)
