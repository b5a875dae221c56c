"""What a planner is: a function from a belief to the next path."""

import abc

import equinox as eqx
from jaxtyping import Array, Float, Int, Key

from bojax.motions.base import Path
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


class Planner(eqx.Module):
    """A way to choose the next path."""

    @abc.abstractmethod
    def plan(self, key: Key[Array, ""], problem: Problem, belief: Belief) -> Plan:
        """The path to drive from `belief`."""
