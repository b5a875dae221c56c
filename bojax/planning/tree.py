"""A belief tree in flat, preallocated arrays."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.problems.base import Node

ROOT = 0
"""Index of the root node."""

UNVISITED = -1
"""Marks an action that has not been simulated."""


class Tree(eqx.Module):
    """N belief nodes with at most A actions each.

    Each action has one observation branch, so that an action and the belief that it leads to share an index:
    `reward`, `visits` and `total_return` of a node are those of the action that leads to it. Iteration i of a
    search can create only node i + 1, in every run of a batch: a new node is written at the same index in all
    lanes, without a scatter.

    Attributes:
        belief: Beliefs of the nodes.
        is_terminal: Whether the episode has ended at a node.
        reward: Reward of the action that leads to a node.
        visits: Number of simulations through a node; for the root, of all simulations.
        total_return: Sum of the returns of these simulations, from the action that leads to the node on.
        children: Nodes that the actions of a node lead to; `UNVISITED` for actions that do not exist yet.
    """

    belief: Node
    is_terminal: Bool[Array, "N"]
    reward: Float[Array, "N"]
    visits: Int[Array, "N"]
    total_return: Float[Array, "N"]
    children: Int[Array, "N A"]

    @classmethod
    def rooted(cls, belief: Node, num_nodes: int, num_actions: int, dtype) -> "Tree":
        """A tree with only a root."""
        beliefs = jax.tree.map(
            lambda leaf: jnp.zeros((num_nodes, *leaf.shape), leaf.dtype).at[ROOT].set(leaf), belief
        )
        return cls(
            belief=beliefs,
            is_terminal=jnp.zeros((num_nodes,), bool),
            reward=jnp.zeros((num_nodes,), dtype),
            visits=jnp.zeros((num_nodes,), jnp.int32),
            total_return=jnp.zeros((num_nodes,), dtype),
            children=jnp.full((num_nodes, num_actions), UNVISITED, jnp.int32),
        )

    def num_children(self, node: Int[Array, ""]) -> Int[Array, ""]:
        """Number of actions that have been simulated from `node`."""
        return jnp.sum(self.children[node] != UNVISITED, dtype=jnp.int32)

    def mean_return(self, nodes: Int[Array, "*K"]) -> Float[Array, "*K"]:
        """Mean return of the actions that lead to `nodes`; minus infinity for `UNVISITED`."""
        visits = self.visits[nodes].astype(self.total_return.dtype)
        mean = self.total_return[nodes] / jnp.maximum(visits, 1.0)
        return jnp.where(nodes == UNVISITED, -jnp.inf, mean)


def best_by_mean(tree: Tree) -> Int[Array, ""]:
    """Child of the root with the highest mean return.

    Deviation: Algorithms 2 and 4 choose the largest sum of returns, which for negative returns favours the
    least visited child.
    """
    children = tree.children[ROOT]
    return children[jnp.argmax(tree.mean_return(children))]


def best_by_uct(tree: Tree, node: Int[Array, ""], exploration: Float[Array, ""]) -> Int[Array, ""]:
    """Child of `node` that maximises the mean return plus `exploration` sqrt(ln n_p / n_i) (4.1).

    The factor 2 under the square root in Algorithm 2 is absorbed by `exploration`.
    """
    children = tree.children[node]
    visits = jnp.maximum(tree.visits[children], 1).astype(tree.total_return.dtype)
    of_parent = jnp.maximum(tree.visits[node], 1).astype(tree.total_return.dtype)
    bonus = exploration * jnp.sqrt(jnp.log(of_parent) / visits)
    return children[jnp.argmax(tree.mean_return(children) + bonus)]
