"""The protocol of a planner: a function from a belief to the next action."""

import abc
from typing import Any, Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.motions.base import Motions
from bojax.problems.base import Action, Belief, Problem
from bojax.problems.path_problem import PathProblem
from bojax.problems.pose import PoseProblem
from bojax.results.schema import Table


class Plan(eqx.Module):
    """The next action, and the planner's predictions for it.

    Attributes:
        action: The action; on a path problem, the path in the robot's frame.
        reward: Predicted reward of the action; None if the planner predicts none.
        value: Mean simulated return of action sequences that start with the action.
        visits: Number of simulations that start with the action.
        measured: What the planner measures of its own plan, by the names of its `run_columns`.
    """

    action: Action
    reward: Float[Array, ""] | None
    value: Float[Array, ""]
    visits: Int[Array, ""]
    measured: dict[str, Float[Array, ""]] = eqx.field(default_factory=dict)

    @property
    def path(self) -> Float[Array, "... S 3"]:
        """The action as a path in the robot's frame."""
        return self.action


class Planner(eqx.Module):
    """An algorithm that chooses the next action."""

    @property
    def num_samples(self) -> int:
        """Largest number of observations that an action yields."""
        return 1

    @property
    def run_columns(self) -> Table:
        """Columns of `runs.parquet` for `Plan.measured`, means over the steps of a run."""
        return ()

    def prepared(self, problem: Any) -> "Planner":
        """The planner with everything that it computes once, on the host, for a problem; by default itself.

        Raises:
            ValueError: The planner cannot be prepared for this problem.
        """
        return self

    def check(self, problem: Any) -> None:
        """Refuse a problem that the planner cannot plan on, or raise ValueError."""
        if isinstance(problem, PathProblem):
            raise ValueError(
                f"planner: {type(self).__name__} does not plan paths, which {type(problem).__name__} needs; "
                "allowed: a PathPlanner"
            )

    @abc.abstractmethod
    def plan(self, key: Key[Array, ""], problem: Any, belief: Belief) -> Plan:
        """The next action for a belief."""


M = TypeVar("M", bound=Motions)  # the family of trajectories of a planner


class PathPlanner(Planner, Generic[M]):
    """An algorithm that chooses the next path of a robot.

    Attributes:
        motions: Family of trajectories that the path is chosen from.
    """

    motions: eqx.AbstractVar[M]

    @property
    @override
    def num_samples(self) -> int:
        return self.motions.num_samples

    @override
    def check(self, problem: Problem) -> None:
        if not isinstance(problem, PathProblem):
            raise ValueError(
                f"planner: {type(self).__name__} plans paths, which {type(problem).__name__} does not have; "
                "allowed: a planner on beliefs of particles"
            )
        problem.check_motions(self.motions)
        objective = getattr(self, "objective", None)
        if objective is not None and isinstance(problem, PoseProblem):
            raise ValueError(
                f"planner.objective: got {type(objective).__name__}; allowed: null, since "
                f"{type(problem).__name__} has no field"
            )
