"""The myopic planner and the myopic explorer: the best next path, without look-ahead (Section 3.3.1)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key
from typing_extensions import override

from bojax.motions.base import DiscreteMotions
from bojax.planning.base import PathPlanner, Plan
from bojax.problems.base import Belief, Objective
from bojax.problems.path_problem import PathProblem


class MyopicPlanner(PathPlanner[DiscreteMotions]):
    """The path of a finite set with the highest simulated reward (3.3); the first in case of a tie.

    Settings: `bojax.planning.settings.Myopic` and `Explorer`.
    """

    motions: DiscreteMotions
    objective: Objective = None

    @override
    def plan(self, key: Key[Array, ""], problem: PathProblem, belief: Belief) -> Plan:
        paths = self.motions.paths()
        root, node = problem.with_objective(self.objective).root(belief, 1)

        def reward(key, path):
            return problem.simulate(key, root, node, path[None], self.objective).rewards[0]

        rewards = jax.vmap(reward)(jax.random.split(key, paths.shape[0]), paths)
        best = jnp.argmax(rewards)
        return Plan(
            action=paths[best], reward=rewards[best], value=rewards[best], visits=jnp.ones((), jnp.int32)
        )
