"""Double progressive widening on paths: the tree of PFT-DPW, with the beliefs of a path problem as they are.

The searches of the thesis imagine one observation an action (Algorithms 2 to 4); with `max_branches`
of 1, so does this one. It proposes actions as searches on particles do.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.motions.base import ContinuousMotions
from bojax.planning.base import PathPlanner, Plan
from bojax.planning.belief_search import BeliefTreeSearch, Expansion
from bojax.planning.search import return_of
from bojax.planning.tree import ROOT, Index, Tree, row
from bojax.problems.actions import Box
from bojax.problems.base import Belief, Objective
from bojax.problems.path_problem import Node, PathProblem, Root


class PathModel(eqx.Module):
    """What is searched in one plan: a path problem, whose actions are parameters of paths."""

    problem: PathProblem
    root: Root  # data shared by the nodes of the plan, and `node`, the root node
    node: Node  # the root node
    rollouts: Float[Array, "C S 3"]  # random paths that rollouts draw from
    actions: Box  # space of the parameters
    discount: Float[Array, ""]  # discount per step


class RolloutRewards(NamedTuple):
    """Reward of each path of a rollout, and whether the episode ends with it."""

    rewards: Float[Array, "H"]
    terminated: Bool[Array, "H"]


class PathDPW(BeliefTreeSearch, PathPlanner[ContinuousMotions]):
    """Tree search on paths with several imagined observations an action.

    A new branch simulates its path and a random rollout to the horizon by one call of `PathProblem.simulate`,
    which draws the observations. A field has the Gaussian process of all samples since the root as its
    belief, exactly; branches of an action are other samples of the same path. On a problem of the robot's
    pose, whose simulations do not measure, all branches are equal: see
    `bojax.problems.pomdp.uncertain_pose`.

    Settings: `bojax.planning.settings.PathDPW`.
    """

    motions: ContinuousMotions
    discount: Float[Array, ""]
    # Number of random paths that the rollouts of a plan draw from
    num_rollout_paths: int = eqx.field(static=True)
    objective: Objective = None  # objective that is maximised; None for the problem's task

    @override
    def plan(self, key: Key[Array, ""], problem: PathProblem, belief: Belief) -> Plan:
        key_paths, key_search = jax.random.split(key)
        model = self.model(key_paths, problem, belief)
        tree = self.search(key_search, model, belief)
        best = tree.root_actions().recommended(self.by_value)
        # The reward of a path is that under the belief before it, which its branches share.
        branch = tree.branches_of(tree.children[ROOT, best.slot])[0]
        return Plan(
            self.motions.path(best.parameters),
            tree.outcome[branch, 0],
            best.value,
            best.visits.astype(jnp.int32),
        )

    def model(self, key: Key[Array, ""], problem: PathProblem, belief: Belief) -> PathModel:
        """What a plan for `belief` searches."""
        root, node = problem.with_objective(self.objective).root(belief, self.depth)
        one = jnp.ones(self.motions.num_params, self.discount.dtype)
        rollouts = jax.vmap(self.motions.sample)(jax.random.split(key, self.num_rollout_paths))
        return PathModel(problem, root, node, rollouts, Box(-one, one), self.discount)

    @override
    def root(self, key: Key[Array, ""], problem: PathModel, belief: Belief) -> Node:
        return problem.node

    @override
    def states(self, key: Key[Array, ""], belief: Belief) -> Float[Array, "N 0"]:
        return jnp.zeros((self.iterations, 0), self.discount.dtype)

    @override
    def expand(
        self,
        key: Key[Array, ""],
        problem: PathModel,
        tree: Tree,
        state: Float[Array, "0"],
        node: Index,
        action: Float[Array, "K"],
    ) -> Expansion:
        key_rollout, key_simulate = jax.random.split(key)
        belief = jax.tree.map(lambda leaf: row(leaf, node), tree.beliefs)
        drawn = jax.random.randint(key_rollout, (self.depth - 1,), 0, self.num_rollout_paths)
        paths = jnp.concatenate([self.motions.path(action)[None], problem.rollouts[drawn]])
        simulated = problem.problem.simulate(key_simulate, problem.root, belief, paths, self.objective)
        rollout = RolloutRewards(simulated.rewards[1:], simulated.terminated[1:])
        return Expansion(simulated.node, simulated.rewards[0], simulated.terminated[0], rollout)

    @override
    def leaf_at(self, tree: Tree, state: Float[Array, "0"], node: Index) -> RolloutRewards:
        """No reward: at the horizon, nothing follows."""
        return RolloutRewards(jnp.zeros(self.depth - 1, state.dtype), jnp.ones(self.depth - 1, bool))

    @override
    def value_of(
        self, key: Key[Array, ""], problem: PathModel, leaf: RolloutRewards, remaining: Int[Array, ""]
    ) -> Float[Array, ""]:
        """The return of the rollout, without rewards past the horizon or after a terminal state."""
        return return_of(leaf.rewards, leaf.terminated, remaining, self.discount)
