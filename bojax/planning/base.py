"""The protocol of a planner: a function from a belief to the next path."""

import abc
from typing import Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Float, Int, Key

from bojax.motions.base import Motions, Path
from bojax.problems.base import Belief, Problem


class Plan(eqx.Module):
    """The next path, and the planner's predictions for it.

    Attributes:
        path: The path, in the robot's frame.
        reward: Predicted reward of the path.
        value: Mean simulated return of action sequences that start with the path.
        visits: Number of simulations that start with the path.
    """

    path: Path
    reward: Float[Array, ""]
    value: Float[Array, ""]
    visits: Int[Array, ""]


M = TypeVar("M", bound=Motions)  # the family of trajectories of a planner


class Planner(eqx.Module, Generic[M]):
    """An algorithm that chooses the next path.

    Attributes:
        motions: Family of trajectories that the path is chosen from.
    """

    motions: eqx.AbstractVar[M]

    @abc.abstractmethod
    def plan(self, key: Key[Array, ""], problem: Problem, belief: Belief) -> Plan:
        """The next path for a belief."""
