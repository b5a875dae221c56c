"""The protocol between a problem, the planners that solve it, and the experiment that runs it."""

import abc
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Array, Bool, Float, Key, Scalar

from bojax.results.outline import Outline
from bojax.results.schema import Column, Table

World = Any
"""True state of the world."""

Belief = Any
"""Belief of the planner."""

Action = Float[Array, "..."]
"""An action: a vector of the space of a state problem, or a path `[S, 3]` of a robot."""

Observation = Any
"""Observation after an action."""

Record = Any
"""Arrays that a problem keeps during an episode, as a tree."""

Objective = Any
"""Objective that a planner maximises; None for the problem's own task."""


class Events(eqx.Module):
    """Outcome of an action in the world.

    Attributes:
        reward: Part of the reward that depends on the world; `Problem.reward` may add a part that depends on
            the belief.
        terminated: Whether the episode has ended.
        failed: Whether the simulation has diverged, which ends the run as failed; None if it cannot diverge.
    """

    reward: eqx.AbstractVar[Float[Array, ""]]
    terminated: eqx.AbstractVar[Bool[Array, ""]]
    failed: eqx.AbstractVar[Bool[Array, ""] | None]


class Problem(eqx.Module):
    """A partially observable planning problem: the world, the belief about it, and what is recorded.

    Actions are arrays. There are two kinds of problem: the actions of a `PathProblem` are paths of a robot;
    a `StateProblem` declares a space of vectors, and is given by a model for one state.

    Attributes:
        max_steps: Actions per episode.
        samples_belief: Whether the belief is drawn from the planner's random numbers, as particles are;
            otherwise it depends on measurements of the world alone.
        lanes_on_cpu: Default number of lanes on a core of a CPU, see `Experiment`.
    """

    max_steps: eqx.AbstractVar[int]
    samples_belief: ClassVar[bool] = False
    # Measured on one core on the parking problem, in milliseconds per plan: kCBTS 6.8 with 4 lanes, 4.3
    # with 8, 4.0 with 16, 4.8 with 32, 4.9 with 50; SBO 1.1, 1.3, 0.9, 1.5, 1.1.
    lanes_on_cpu: ClassVar[int] = 16

    def __check_init__(self) -> None:
        if self.max_steps < 1:
            raise ValueError(f"max_steps: got {self.max_steps}; allowed: >= 1")

    @property
    @abc.abstractmethod
    def run_columns(self) -> Table:
        """Columns of `runs.parquet`: those of `summary`, and any that the experiment fills in (see below)."""

    @property
    @abc.abstractmethod
    def step_columns(self) -> Table:
        """Columns of `steps.parquet`: those of `row`, and any that the experiment fills in (see below)."""

    @abc.abstractmethod
    def reset(self, key: Key[Array, ""]) -> World:
        """Initial state of an episode."""

    @abc.abstractmethod
    def prior(self, key: Key[Array, ""], world: World, num_samples: int) -> Belief:
        """Initial belief; an action yields at most `num_samples` observations."""

    @abc.abstractmethod
    def execute(self, key: Key[Array, ""], world: World, action: Action) -> tuple[World, Observation, Events]:
        """Execute an action in the world."""

    @abc.abstractmethod
    def update(
        self, belief: Belief, action: Action, observation: Observation, key: Key[Array, ""] | None = None
    ) -> Belief:
        """The belief after an observation; `key` is None unless the problem `samples_belief`."""

    @property
    def return_discount(self) -> Float[Array, ""] | None:
        """Discount per step of `discounted_return`; None if the problem has no discount."""
        return None

    def reward(self, objective: Objective, belief: Belief, action: Action, events: Any) -> Scalar:
        """Reward of an action; `belief` is the belief before its execution."""
        return events.reward

    @abc.abstractmethod
    def row(self, world: World) -> dict[str, Scalar]:
        """What `steps.parquet` says about the world after an action; at least one number."""

    def step_row(self, action: Action, observation: Observation) -> dict[str, Scalar]:
        """What `steps.parquet` says about an action and what was observed then; nothing by default."""
        return {}

    def belief_row(self, world: World, belief: Belief) -> dict[str, Scalar]:
        """What `steps.parquet` says about the belief after an action; nothing by default."""
        return {}

    @abc.abstractmethod
    def summary(self, record: Record, world: World, belief: Belief) -> dict[str, Scalar]:
        """What `runs.parquet` says about an episode, beside what the experiment fills in."""

    def begin_record(self, world: World, belief: Belief, num_samples: int) -> Record:
        """The record before the first action, of `max_steps` actions; None if nothing is recorded."""
        return None

    def record(
        self, record: Record, step: Scalar, action: Action, events: Any, world: World, belief: Belief
    ) -> Record:
        """The record after action number `step`, counted from 0, with the world and the belief after it."""
        return record

    def arrays(self, record: Record, world: World, belief: Belief) -> dict[str, dict[str, Array]]:
        """Arrays saved at the end of a recorded episode: `{name: {array name: array}}`."""
        return {}

    def outline(self) -> Outline | None:
        """The world as figures and films draw it; None if its settings class has it, or nothing is drawn."""
        return None


# Columns of `runs.parquet` that the experiment fills in.
RETURN = Column("return", "float64", "", "sum of the task's rewards")
DISCOUNTED_RETURN = Column(
    "discounted_return", "float64", "", "sum of the task's rewards, each discounted by its step"
)
STEPS = Column("steps", "int32", "", "actions taken")

# Columns of `steps.parquet` that the experiment fills in.
STEP = Column("step", "int32", "", "number of the action, from 1")
REWARD = Column("reward", "float64", "", "the task's reward")
PLANNED_REWARD = Column("planned_reward", "float64", "", "reward that the planner expected of the action")
PLANNED_VALUE = Column(
    "planned_value",
    "float64",
    "",
    "discounted return that the planner expected of the action; null of a policy",
    nullable=True,
)
ACCUMULATED_REWARD = Column("accumulated_reward", "float64", "", "sum of the task's rewards so far")
DONE = Column("done", "bool", "", "the episode ended with this action")
