"""The random baseline."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key
from typing_extensions import override

from bojax.motions.base import Motions
from bojax.planning.base import PathPlanner, Plan
from bojax.problems.base import Belief
from bojax.problems.path_problem import PathProblem


class RandomPlanner(PathPlanner[Motions]):
    """A path drawn uniformly from a family of trajectories.

    Settings: `bojax.planning.settings.Random`.
    """

    motions: Motions

    @override
    def plan(self, key: Key[Array, ""], problem: PathProblem, belief: Belief) -> Plan:
        # One simulation of the path predicts its reward.
        key_path, key_simulate = jax.random.split(key)
        path = self.motions.sample(key_path)
        root, node = problem.root(belief, 1)
        reward = problem.simulate(key_simulate, root, node, path[None], None).rewards[0]
        return Plan(action=path, reward=reward, value=reward, visits=jnp.ones((), jnp.int32))
