"""Tree search in belief space: descend, expand, roll out, back up (Algorithms 2 and 4)."""

import abc
from typing import Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.motions.base import Path
from bojax.planning.base import M, Plan, Planner
from bojax.planning.tree import ROOT, UNVISITED, Tree
from bojax.problems.base import Belief, Objective, Problem, Root

Memory = TypeVar("Memory", bound=eqx.Module)
"""What a planner stores for every node to choose actions there: node models, stencils."""

Draws = TypeVar("Draws", bound=eqx.Module)
"""Random numbers of all iterations, drawn before the first: arrays with a leading axis of iterations."""

View = TypeVar("View")
"""What a planner reads at a node, both to descend and to propose an action there."""

Update = TypeVar("Update", bound=eqx.Module | None)
"""What a new action changes in the memory."""


class Proposal(eqx.Module, Generic[Update]):
    """A new action of a node.

    Attributes:
        path: Path of the action.
        index: Index of the action among the actions of the node.
        update: Change of the memory once the action has been simulated.
    """

    path: Path
    index: Int[Array, ""]
    update: Update


class TreeSearch(Planner[M], Generic[Memory, Draws, View, Update, M]):
    """The tree search that all tree planners share; a planner defines how a node chooses its actions.

    An iteration descends from the root as long as `select` returns a child. At the first node where it does
    not, the search adds the action of `propose`, simulates that action and a random rollout to the horizon by
    one call of `Problem.simulate`, and backs up: every action on the way is credited with its own reward and
    all later ones. (The published algorithms back up the reward of the rollout only.) Depth counts actions.
    Terminal nodes are not expanded.
    """

    discount: eqx.AbstractVar[Float[Array, ""]]
    iterations: eqx.AbstractVar[int]
    depth: eqx.AbstractVar[int]
    objective: eqx.AbstractVar[Objective]

    @property
    @abc.abstractmethod
    def num_actions(self) -> int:
        """Largest number A of actions of a node."""

    @abc.abstractmethod
    def begin(self, key: Key[Array, ""], dtype) -> tuple[Memory, Draws]:
        """The initial memory, and the random numbers of all iterations."""

    @abc.abstractmethod
    def rollout(self, memory: Memory, draws: Draws) -> Float[Array, "H S 3"]:
        """Paths of the rollout after a new action, possibly none; `draws` are those of one iteration."""

    @abc.abstractmethod
    def view(self, tree: Tree, memory: Memory, node: Int[Array, ""]) -> View:
        """What `select` and `propose` read at `node`: at least its index."""

    @abc.abstractmethod
    def select(self, tree: Tree, memory: Memory, view: View) -> Int[Array, ""]:
        """The child of the node to descend to, or `UNVISITED` to add a new action there."""

    @abc.abstractmethod
    def propose(self, tree: Tree, memory: Memory, view: View, draws: Draws) -> Proposal[Update]:
        """A new action of the node."""

    @abc.abstractmethod
    def learn(
        self, memory: Memory, child: Int[Array, ""], proposal: Proposal[Update], is_new: Bool[Array, ""]
    ) -> Memory:
        """The memory after the action that leads to `child` has been simulated.

        If `is_new` is false, the action is discarded: no node refers to `child`, so that any value may be
        stored for it, but the values of other nodes must not change.
        """

    @abc.abstractmethod
    def recommend(self, tree: Tree, memory: Memory) -> Int[Array, ""]:
        """The child of the root whose action is executed."""

    @abc.abstractmethod
    def path_of(self, memory: Memory, child: Int[Array, ""]) -> Path:
        """The path of the action that leads to `child`."""

    @override
    def plan(self, key: Key[Array, ""], problem: Problem, belief: Belief) -> Plan:
        tree, memory = self.search(key, problem, belief)
        child = self.recommend(tree, memory)
        return Plan(
            path=self.path_of(memory, child),
            reward=tree.reward[child],
            value=tree.mean_return(child),
            visits=tree.visits[child],
        )

    def search(self, key: Key[Array, ""], problem: Problem, belief: Belief) -> tuple[Tree, Memory]:
        """The tree and the planner's memory after all iterations."""
        dtype = self.discount.dtype
        key_begin, key_simulate = jax.random.split(key)
        root, root_node = problem.root(belief, self.depth)
        tree = Tree.rooted(root_node, self.iterations + 1, self.num_actions, dtype)
        memory, draws = self.begin(key_begin, dtype)
        keys = jax.random.split(key_simulate, self.iterations)

        def iterate(carry, xs):
            tree, memory = carry
            child, draws, key = xs
            return self._iterate(problem, root, tree, memory, child, draws, key), None

        children = jnp.arange(1, self.iterations + 1, dtype=jnp.int32)
        (tree, memory), _ = jax.lax.scan(iterate, (tree, memory), (children, draws, keys))
        return tree, memory

    def _iterate(
        self, problem: Problem, root: Root, tree: Tree, memory: Memory, child, draws: Draws, key
    ) -> tuple[Tree, Memory]:
        # Descend. The depth is small and static: the loop is unrolled and masked.
        node = jnp.asarray(ROOT, jnp.int32)
        is_descending = jnp.asarray(True)
        visited = []  # per level: the node, and whether the descent reached it
        view = here = self.view(tree, memory, node)
        for level in range(self.depth):
            if level > 0:
                here = self.view(tree, memory, node)
                view = _where(is_descending, here, view)  # of the node at which the descent ends
            selected = self.select(tree, memory, here)
            is_descending = is_descending & (selected != UNVISITED) & ~tree.is_terminal[node]
            node = jnp.where(is_descending, selected, node)
            visited.append((node, is_descending))
        level = sum(reached.astype(jnp.int32) for _, reached in visited)
        is_new = (level < self.depth) & ~tree.is_terminal[node]

        # Expand and roll out in one simulation; rewards past the horizon or a terminal state do not count.
        proposal = self.propose(tree, memory, view, draws)
        paths = jnp.concatenate([proposal.path[None], self.rollout(memory, draws)])
        belief = jax.tree.map(lambda leaf: leaf[node], tree.belief)
        simulation = problem.simulate(key, root, belief, paths, self.objective)
        future = jnp.zeros((), tree.reward.dtype)
        for step in reversed(range(paths.shape[0])):
            is_within = level + step < self.depth
            ended = simulation.terminated[step]
            reward = simulation.rewards[step]
            rest = jnp.where(ended, 0.0, self.discount * future)
            future = jnp.where(is_within, reward + rest, 0.0)

        # Back up from the new node, if there is one, along the nodes visited to the root.
        nodes, gains = [jnp.where(is_new, child, tree.visits.shape[0])], [future]
        gain = jnp.where(is_new, future, 0.0)
        for reached_node, reached in reversed(visited):
            gain = jnp.where(reached, tree.reward[reached_node] + self.discount * gain, gain)
            nodes.append(jnp.where(reached, reached_node, tree.visits.shape[0]))
            gains.append(gain)
        nodes.append(jnp.asarray(ROOT, jnp.int32))
        gains.append(gain)
        indices = jnp.stack(nodes)

        index = jnp.where(is_new, proposal.index, tree.children.shape[1])
        tree = Tree(
            belief=jax.tree.map(lambda all, one: all.at[child].set(one), tree.belief, simulation.node),
            is_terminal=tree.is_terminal.at[child].set(simulation.terminated[0]),
            reward=tree.reward.at[child].set(simulation.rewards[0]),
            visits=tree.visits.at[indices].add(1, mode="drop"),
            total_return=tree.total_return.at[indices].add(jnp.stack(gains), mode="drop"),
            children=tree.children.at[node, index].set(child, mode="drop"),
        )
        return tree, self.learn(memory, child, proposal, is_new)


def _where(condition: Bool[Array, ""], yes: View, no: View) -> View:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
