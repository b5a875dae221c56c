"""Tree search in belief space: descend, expand, roll out, back up (Algorithms 2 and 4)."""

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Num
from typing_extensions import override

from bojax.motions.base import Path
from bojax.numerics.lanes import batched_together
from bojax.planning.base import M, PathPlanner, Plan
from bojax.planning.tree import ROOT, UNVISITED, Growth, Index, Tree, best_by_mean
from bojax.problems.base import Belief, Objective
from bojax.problems.path_problem import PathProblem, Root

Memory = Any
"""What a planner stores for every node to choose actions there (node models, stencils), and `paths`."""

View = Any
"""What a planner computes at a node, both to descend and to propose an action there."""


class Proposal(eqx.Module):
    """A new action of a node."""

    path: Path  # path of the action
    index: Int[Array, ""]  # index of the action among the actions of the node
    update: Any  # change of the memory once the action has been simulated


class PlanDraws(eqx.Module):
    """Random numbers of all iterations, drawn before the first: arrays with a leading axis of iterations."""

    rollout: Int[Array, "... H"]  # indices of the paths of the memory that the rollout follows
    # What decides among untried actions: a priority of each, or the index of a candidate
    untried: Num[Array, "..."]


class TreeSearch(PathPlanner[M]):
    """The tree search that all tree planners share; a planner defines how a node chooses its actions.

    An iteration descends from the root as long as `select` returns a child. At the first node where it does
    not, the search adds the action of `propose`, simulates that action and a random rollout to the horizon by
    one call of `PathProblem.simulate`, and backs up: every action on the way is credited with its own reward
    and all later ones. Depth counts actions. Terminal nodes are not expanded.

    Deviation: Algorithms 2 and 4, as printed, back up only the reward of the rollout.
    """

    discount: Float[Array, ""]
    iterations: int = eqx.field(static=True)
    depth: int = eqx.field(static=True)
    objective: eqx.AbstractVar[Objective]

    @property
    @abc.abstractmethod
    def num_actions(self) -> int:
        """Largest number A of actions of a node."""

    @abc.abstractmethod
    def begin(self, key: Key[Array, ""], dtype) -> tuple[Memory, PlanDraws]:
        """The initial memory, and the random numbers of all iterations."""

    def rollout(self, memory: Memory, draws: PlanDraws) -> Float[Array, "H S 3"]:
        """Paths of the rollout after a new action, possibly none; `draws` are those of one iteration."""
        return memory.paths[draws.rollout]

    @abc.abstractmethod
    def view(self, tree: Tree, memory: Memory, node: Index) -> View:
        """What `select` and `propose` read at `node`: it depends on the node and its children only."""

    def select(self, view: View) -> Index:
        """The child of the node to descend to, or `UNVISITED` to add an action there; by default `view`."""
        return view

    @abc.abstractmethod
    def propose(self, tree: Tree, memory: Memory, node: Index, view: View, draws: PlanDraws) -> Proposal:
        """A new action of `node`, whose view is `view`."""

    @abc.abstractmethod
    def learn(self, memory: Memory, child: Index, proposal: Proposal, is_new: Bool[Array, ""]) -> Memory:
        """The memory after the action that leads to `child` has been simulated.

        If `is_new` is false, the action is discarded: no node refers to `child`, so that any value may be
        stored for it, but the values of other nodes must not change.
        """

    def recommend(self, tree: Tree, memory: Memory) -> Index:
        """The child of the root whose action is executed; by default the one with the highest mean return."""
        return best_by_mean(tree)

    @abc.abstractmethod
    def path_of(self, memory: Memory, child: Index) -> Path:
        """The path of the action that leads to `child`."""

    @override
    def plan(self, key: Key[Array, ""], problem: PathProblem, belief: Belief) -> Plan:
        tree, memory = self.search(key, problem, belief)
        child = self.recommend(tree, memory)
        return Plan(
            action=self.path_of(memory, child),
            reward=tree.reward[child],
            value=tree.mean_return(child),
            visits=tree.visits[child].astype(jnp.int32),
            measured=self.measure(problem, belief, tree, memory),
        )

    def measure(
        self, problem: PathProblem, belief: Belief, tree: Tree, memory: Memory
    ) -> dict[str, Float[Array, ""]]:
        """What `run_columns` are the means of, after a search."""
        return {}

    def search(self, key: Key[Array, ""], problem: PathProblem, belief: Belief) -> tuple[Tree, Memory]:
        """The tree and the planner's memory after all iterations."""
        dtype = self.discount.dtype
        key_begin, key_simulate = jax.random.split(key)
        root, root_node = problem.with_objective(self.objective).root(belief, self.depth)
        tree = Tree.rooted(root_node, self.iterations, self.num_actions, dtype)
        memory, draws = self.begin(key_begin, dtype)
        # Every node starts with the root's view as a placeholder: its own is computed in the iteration after
        # the one that adds it, before a descent can reach it.
        view = self.view(tree, memory, jnp.asarray(ROOT, jnp.int32))
        views = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (self.iterations + 1, *leaf.shape)), view)
        keys = jax.random.split(key_simulate, self.iterations)

        def iterate(carry, xs):
            tree, memory, views, growth = carry
            child, draws, key = xs
            return self._iterate(problem, root, tree, memory, views, growth, child, draws, key), None

        # Iteration i may add node i + 1 and no other. The first iteration writes a growth that changes
        # nothing.
        children = jnp.arange(1, self.iterations + 1, dtype=jnp.int32)
        growth = Growth(
            index=children[0],
            belief=root_node,
            outcome=jnp.zeros((2,), dtype),
            credited=jnp.full((self.depth + 1,), self.iterations + 1, jnp.int32),
            added=jnp.zeros((self.depth + 1, 2), dtype),
            node=jnp.asarray(ROOT, jnp.int32),
            slot=jnp.asarray(self.num_actions, jnp.int32),
        )
        without_index = eqx.tree_at(lambda growth: growth.index, growth, None)
        tree, views, batched = batched_together((tree, views, without_index))
        # `index` stays out of the batch: an index that all lanes share is written without a scatter.
        carry = tree, memory, views, eqx.combine(batched, growth)
        (tree, memory, _, growth), _ = jax.lax.scan(iterate, carry, (children, draws, keys))
        return tree.grown(growth), memory  # the growth of the last iteration is still to be written

    def _iterate(
        self,
        problem: PathProblem,
        root: Root,
        tree: Tree,
        memory: Memory,
        views: View,
        growth: Growth,
        child: Index,
        draws: PlanDraws,
        key: Key[Array, ""],
    ) -> tuple[Tree, Memory, View, Growth]:
        """One iteration, which writes `growth`, of the previous one, and adds the node `child`."""
        # Write the results of the previous iteration first, and read the tree only then: XLA writes in place,
        # but would copy an array that is also read by instructions independent of the new values.
        tree = tree.grown(growth)
        # The view of a node changes only when a simulation passes through it. The nodes visited last renew
        # theirs as one batch, and the descent below only reads: half the kernels, on a GPU, of a descent that
        # computes the views level by level. Nodes at the horizon (`credited[0]`) have no actions and need no
        # view; the index of a level that was not reached is past the end, and its write is dropped.
        visited = growth.credited[1:]
        renewed = jax.vmap(self.view, in_axes=(None, None, 0))(tree, memory, visited)
        views = jax.tree.map(lambda all, new: all.at[visited].set(new, mode="drop"), views, renewed)

        # TreePolicy of Algorithms 2 and 4. A lane whose descent ends at the horizon or at a terminal node has
        # nothing to add. It simulates all the same, as a branch would be computed in every lane of a batch;
        # `is_new` then masks what it found.
        descent = self._descend(views)
        node, level = descent.node, descent.level
        is_terminal = tree.outcome[node][1] > 0.0
        is_new = (level < self.depth) & ~is_terminal

        # Expand and roll out in one simulation: the action and all random ones after it, from this node.
        proposal = self.propose(tree, memory, node, _at(views, node), draws)
        paths = jnp.concatenate([proposal.path[None], self.rollout(memory, draws)])
        simulation = problem.simulate(key, root, _at(tree.beliefs, node), paths, self.objective)
        # All lanes simulate equally many paths, from nodes of different levels.
        future = return_of(simulation.rewards, simulation.terminated, self.depth - level, self.discount)

        nodes, gained = self._back_up(tree, descent, child, is_new, future)
        growth = Growth(
            index=child,
            belief=simulation.node,
            outcome=jnp.stack([simulation.rewards[0], simulation.terminated[0].astype(future.dtype)]),
            credited=nodes,
            added=jnp.stack([jnp.ones_like(gained), gained], axis=-1),
            node=node,
            slot=jnp.where(is_new, proposal.index, self.num_actions),
        )
        return tree, self.learn(memory, child, proposal, is_new), views, growth

    def _descend(self, views: View) -> "_Descent":
        """Descend from the root until `select` returns no child."""
        # The depth is small and static: the loop is unrolled. A lane whose descent has ended keeps its node.
        node = jnp.asarray(ROOT, jnp.int32)
        is_descending = jnp.asarray(True)
        visited = []
        for _ in range(self.depth):
            selected = self.select(_at(views, node))
            is_descending = is_descending & (selected != UNVISITED)
            node = jnp.where(is_descending, selected, node)
            visited.append((node, is_descending))
        level = jnp.asarray(sum(reached.astype(jnp.int32) for _, reached in visited))
        return _Descent(node, level, visited)

    def _back_up(
        self, tree: Tree, descent: "_Descent", child: Index, is_new: Bool[Array, ""], future: Float[Array, ""]
    ) -> tuple[Int[Array, "L"], Float[Array, "L"]]:
        """The nodes from the new one, if there is one, back to the root, and the return gained from each."""
        nowhere = tree.children.shape[0]  # past the end: such writes are dropped
        nodes, gains = [], []  # the deepest level first
        # BackUp of Algorithm 4 with all rewards on the way. Below the last node reached, `gain` is the return
        # from the new action on, credited to the new node one level deeper; other levels name no node.
        gain = jnp.where(is_new, future, 0.0)
        for above, (node, reached) in reversed(list(enumerate(descent.visited))):
            gain = jnp.where(reached, tree.outcome[node][0] + self.discount * gain, gain)
            added = jnp.where(is_new & (descent.level == above), child, nowhere)
            nodes.append(jnp.where(reached, node, added))
            gains.append(gain)
        nodes.append(jnp.asarray(ROOT, jnp.int32))
        gains.append(gain)
        return jnp.stack(nodes), jnp.stack(gains)


class _Descent(NamedTuple):
    """A descent from the root."""

    node: Int[Array, ""]  # the last node reached
    level: Int[Array, ""]  # its number of actions from the root
    # At each level below the root: the node, and whether the descent reached it
    visited: list[tuple[Int[Array, ""], Bool[Array, ""]]]


def return_of(
    rewards: Float[Array, "H"] | Sequence[Float[Array, ""]],
    terminated: Bool[Array, "H"] | Sequence[Bool[Array, ""]],
    number: Int[Array, ""],
    discount: Float[Array, ""],
) -> Float[Array, ""]:
    """The return of the first `number` simulated paths, without rewards after a terminal state."""
    # Backwards, R_t = r_t + gamma R_(t+1). What is cut off may be any number, even NaN, which `where` stops.
    value = jnp.zeros((), discount.dtype)
    for step in reversed(range(len(rewards))):
        later = jnp.where(terminated[step], 0.0, discount * value)
        value = jnp.where(step < number, rewards[step] + later, 0.0)
    return value


def _at(rows: View, node: Index) -> View:
    """The row of a node in every array of a tree."""
    return jax.tree.map(lambda leaf: leaf[node], rows)
