"""A planner of my own: the action with the highest simulated reward, one step ahead."""

from typing import Annotated

import jax
import jax.numpy as jnp
import pydantic
from jaxtyping import Array, Key

from bojax.config.component import Component, Slot
from bojax.motions.base import DiscreteMotions
from bojax.motions.settings import Splines
from bojax.planning.base import PathPlanner, Plan
from bojax.problems.base import Belief
from bojax.problems.path_problem import PathProblem


class Greedy(PathPlanner):
    """Exhaustive search over a set of actions, one step ahead."""

    motions: DiscreteMotions

    class Config(pydantic.BaseModel):
        """Settings of the planner; without `Config`, they are the annotated arguments of the constructor."""

        motions: Annotated[Component, Slot("motions", only=Splines)] = Splines()

    def plan(self, key: Key[Array, ""], problem: PathProblem, belief: Belief) -> Plan:
        """The path to drive from `belief`, in the robot's frame."""
        paths = self.motions.paths()
        root, node = problem.root(belief, horizon=1)

        def simulate(path):
            return problem.simulate(key, root, node, path[None], None).rewards[0]

        rewards = jax.vmap(simulate)(paths)
        best = jnp.argmax(rewards)
        return Plan(paths[best], reward=rewards[best], value=rewards[best], visits=jnp.ones((), jnp.int32))
