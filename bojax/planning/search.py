"""Tree search over beliefs: descend, expand, roll out, back up (Algorithms 2 and 4)."""

import abc
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.motions.base import Path
from bojax.planning.base import M, Plan, Planner
from bojax.planning.tree import ROOT, UNVISITED, Tree
from bojax.problems.base import Belief, Objective, Problem

Memory = TypeVar("Memory")
"""What a planner keeps of every node to choose actions there: node models, stencils."""

Draws = Any
"""Random numbers of a plan, drawn at its start: a tree of arrays with a leading axis of iterations."""


class Proposal(eqx.Module):
    """A new action of a node.

    Attributes:
        path: Its path.
        slot: Its place among the node's actions.
        note: What `learn` needs to remember it by.
    """

    path: Path
    slot: Int[Array, ""]
    note: Any = None


class TreeSearch(Planner[M], Generic[Memory, M]):
    """The search that all tree planners share; a planner says how a node chooses its actions.

    One iteration descends from the root while `select` names a child, expands the node where it does not
    with the action that `propose` makes, plays that action and random ones to the horizon in one call of
    `Problem.simulate`, and adds to every action on the way its own reward and all that follow (the
    algorithms print that only the rollout's reward is backed up). Depth counts actions. A node where the
    episode ended is not expanded.

    Attributes:
        discount: Discount a step.
        iterations: Simulations a plan.
        depth: Actions from the root to the horizon.
        objective: What to maximise, if not the problem's own task.
    """

    discount: eqx.AbstractVar[Float[Array, ""]]
    iterations: eqx.AbstractVar[int]
    depth: eqx.AbstractVar[int]
    objective: eqx.AbstractVar[Objective]

    @property
    @abc.abstractmethod
    def num_actions(self) -> int:
        """Most actions A that a node can have."""

    @abc.abstractmethod
    def begin(self, key: Key[Array, ""], dtype) -> tuple[Memory, Draws]:
        """The empty memory, and the random numbers of all iterations."""

    @abc.abstractmethod
    def rollout(self, memory: Memory, draws: Draws) -> Float[Array, "H S 3"]:
        """Random paths that follow a new action to the horizon, or none; `draws` are of one iteration."""

    @abc.abstractmethod
    def select(self, tree: Tree, memory: Memory, node: Int[Array, ""]) -> Int[Array, ""]:
        """The child of `node` to descend to, or `UNVISITED` to ask for a new action there."""

    @abc.abstractmethod
    def propose(self, tree: Tree, memory: Memory, node: Int[Array, ""], draws: Draws) -> Proposal:
        """A new action of `node`."""

    @abc.abstractmethod
    def learn(
        self, memory: Memory, child: Int[Array, ""], proposal: Proposal, is_new: Bool[Array, ""]
    ) -> Memory:
        """The memory with the action that leads to `child`.

        Unless `is_new` the action was not played: no node refers to `child`, whatever is stored for it,
        but what is stored for other nodes must not change.
        """

    @abc.abstractmethod
    def recommend(self, tree: Tree, memory: Memory) -> Int[Array, ""]:
        """The child of the root whose action is to be taken."""

    @abc.abstractmethod
    def path_of(self, memory: Memory, child: Int[Array, ""]) -> Path:
        """The path of the action that leads to `child`."""

    def plan(self, key: Key[Array, ""], problem: Problem, belief: Belief) -> Plan:
        """See `Planner`."""
        tree, memory = self.search(key, problem, belief)
        child = self.recommend(tree, memory)
        return Plan(
            path=self.path_of(memory, child),
            reward=tree.reward[child],
            value=tree.mean_return(child),
            visits=tree.visits[child],
        )

    def search(self, key: Key[Array, ""], problem: Problem, belief: Belief) -> tuple[Tree, Memory]:
        """The tree after all iterations, and what the planner remembers of its nodes."""
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

    def _iterate(self, problem, root, tree: Tree, memory, child, draws, key) -> tuple[Tree, Any]:
        # Descend: the depth is small and fixed, so the loop is unrolled and masked.
        node = jnp.asarray(ROOT, jnp.int32)
        is_descending = jnp.asarray(True)
        visited = []  # (node reached, whether it was) for each level
        for _ in range(self.depth):
            selected = self.select(tree, memory, node)
            is_descending = is_descending & (selected != UNVISITED) & ~tree.is_terminal[node]
            node = jnp.where(is_descending, selected, node)
            visited.append((node, is_descending))
        level = sum(reached.astype(jnp.int32) for _, reached in visited)
        is_new = (level < self.depth) & ~tree.is_terminal[node]

        # Expand and roll out in one simulation; what lies past the horizon or an end does not count.
        proposal = self.propose(tree, memory, node, draws)
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

        # Back up: from the new node, if there is one, through the nodes visited to the root.
        nodes, gains = [jnp.where(is_new, child, tree.visits.shape[0])], [future]
        gain = jnp.where(is_new, future, 0.0)
        for reached_node, reached in reversed(visited):
            gain = jnp.where(reached, tree.reward[reached_node] + self.discount * gain, gain)
            nodes.append(jnp.where(reached, reached_node, tree.visits.shape[0]))
            gains.append(gain)
        nodes.append(jnp.asarray(ROOT, jnp.int32))
        gains.append(gain)
        indices = jnp.stack(nodes)

        slot = jnp.where(is_new, proposal.slot, tree.children.shape[1])
        tree = Tree(
            belief=jax.tree.map(lambda all, one: all.at[child].set(one), tree.belief, simulation.node),
            is_terminal=tree.is_terminal.at[child].set(simulation.terminated[0]),
            reward=tree.reward.at[child].set(simulation.rewards[0]),
            visits=tree.visits.at[indices].add(1, mode="drop"),
            total_return=tree.total_return.at[indices].add(jnp.stack(gains), mode="drop"),
            children=tree.children.at[node, slot].set(child, mode="drop"),
        )
        return tree, self.learn(memory, child, proposal, is_new)
