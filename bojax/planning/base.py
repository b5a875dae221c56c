"""What a planner is: a function from a belief to the next path."""

import abc
from typing import Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Float, Int, Key

from bojax.motions.base import Motions, Path
from bojax.problems.base import Belief, Problem


class Plan(eqx.Module):
    """The path to drive next, and what the planner expects of it.

    Attributes:
        path: The path, in the robot's frame.
        reward: Reward that the planner expects of this path.
        value: Mean simulated return of starting with this path.
        visits: Number of simulations that started with this path.
    """

    path: Path
    reward: Float[Array, ""]
    value: Float[Array, ""]
    visits: Int[Array, ""]


M = TypeVar("M", bound=Motions)
"""The family of trajectories of a planner."""


class Planner(eqx.Module, Generic[M]):
    """A way to choose the next path.

    Attributes:
        motions: The family that the path is of.
    """

    motions: eqx.AbstractVar[M]

    @abc.abstractmethod
    def plan(self, key: Key[Array, ""], problem: Problem, belief: Belief) -> Plan:
        """The path to drive from `belief`."""
