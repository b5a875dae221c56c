"""The protocol between a problem, the planners that solve it, and the experiment that runs it."""

import abc
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Array, Bool, Float, Key, Scalar

from bojax.motions.base import Path, Pose
from bojax.results.outline import Outline
from bojax.results.schema import Column, Table

World = Any
"""True state of the world."""

Belief = Any
"""Belief of the planner."""

Node = Any
"""Belief at a node of the search tree: a tree of arrays that the search stores for every node."""

Root = Any
"""Data shared by all nodes of a plan, computed once per plan, such as the factored posterior of a field."""

Observation = Any
"""Observation after the execution of a path."""

Objective = Any
"""Objective that a planner maximises; None for the problem's own task."""


class Events(eqx.Module):
    """Outcome of the execution of a path in the world.

    Attributes:
        reward: Part of the reward that depends on the world; `Problem.reward` adds the part that depends on
            the belief.
        terminated: Whether the episode has ended.
        success: Whether the task is solved.
        exited: Whether the robot left the domain.
        driven: Poses of the robot in the world frame; past the pose at which it stopped, that pose is
            repeated.
        is_driven: Whether the robot reached each pose of the path.
        frames: Generalised positions during the motion, for an animation; None if there is nothing to
            animate.
        failed: Whether the simulation has diverged, which ends the run as failed; None if it cannot diverge.
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
    """Result of simulating an action sequence from a node of the search tree.

    Attributes:
        node: Belief after the first action.
        rewards: Reward of each action.
        terminated: Whether the episode ends with each action; later actions are ignored.
    """

    node: Node
    rewards: Float[Array, "H"]
    terminated: Bool[Array, "H"]


class Problem(eqx.Module):
    """A partially observable planning problem with paths of a robot as actions.

    Paths are given in the robot's frame; the problem transforms them to the world frame. `simulate` takes a
    whole action sequence, so that a problem can evaluate a node and its rollout at once.

    Attributes:
        max_steps: Actions per episode.
        scores: Columns of `runs.parquet` that `score` computes.
        lanes_on_cpu: Default number of lanes on a core of a CPU, see `Experiment`.
    """

    max_steps: eqx.AbstractVar[int]
    scores: ClassVar[Table] = ()
    # Measured on one core on the parking problem, in milliseconds per plan: kCBTS 6.8 with 4 lanes, 4.3
    # with 8, 4.0 with 16, 4.8 with 32, 4.9 with 50; SBO 1.1, 1.3, 0.9, 1.5, 1.1.
    lanes_on_cpu: ClassVar[int] = 16

    @abc.abstractmethod
    def reset(self, key: Key[Array, ""]) -> World:
        """Initial state of an episode."""

    @abc.abstractmethod
    def prior(self, key: Key[Array, ""], world: World, num_samples: int) -> Belief:
        """Initial belief; a path yields at most `num_samples` observations."""

    @abc.abstractmethod
    def execute(self, key: Key[Array, ""], world: World, path: Path) -> tuple[World, Observation, Events]:
        """Execute a path in the world."""

    @abc.abstractmethod
    def update(self, belief: Belief, path: Path, observation: Observation) -> Belief:
        """The belief after an observation."""

    @abc.abstractmethod
    def reward(self, objective: Objective, belief: Belief, path: Path, events: Events) -> Scalar:
        """Reward of a path; `belief` is the belief before its execution."""

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

    def outline(self) -> Outline | None:
        """The world as figures and films draw it; None if its settings class has it, or nothing is drawn."""
        return None

    @property
    def turning_radius(self) -> float:
        """Smallest radius of a curve that the robot can follow, in metres."""
        return 0.0

    @property
    def reach(self) -> float:
        """Length of the longest path that the robot can complete, in metres."""
        return float("inf")

    def snapshot(self, world: World, belief: Belief) -> dict[str, dict[str, Array]]:
        """Arrays recorded at the end of an episode: `{name: {array name: array}}`."""
        return {}

    def score(self, world: World, belief: Belief) -> dict[str, Scalar]:
        """Scores of the final belief, one per column of `scores`."""
        return {}


POSE_COLUMNS: Table = (
    Column("x", "float64", "m", "true position after the step"),
    Column("y", "float64", "m", "true position after the step"),
    Column("heading", "float64", "rad", "true heading after the step, in [0, 2 pi)"),
)
