"""A belief tree in flat, preallocated arrays."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bojax.problems.path_problem import Node

ROOT = 0  # index of the root node
UNVISITED = -1  # marks an action that has not been simulated


class Tree(eqx.Module):
    """N belief nodes with at most A actions each.

    Each action has one observation branch, so that an action and the belief that it leads to share an index:
    `reward`, `visits` and `total_return` of a node belong to the action that leads to it.

    Attributes:
        belief: Beliefs of the nodes.
        outcome: `reward` and `is_terminal` of the nodes.
        totals: `visits` and `total_return` of the nodes.
        children: Nodes that the actions of a node lead to; `UNVISITED` for actions that do not exist yet.
    """

    # Numbers that are written together are one array: each array costs a GPU a kernel in every iteration.
    belief: Node
    outcome: Float[Array, "N 2"]
    totals: Float[Array, "N 2"]
    children: Int[Array, "N A"]

    @classmethod
    def rooted(cls, belief: Node, num_nodes: int, num_actions: int, dtype) -> "Tree":
        """A tree with only a root."""
        beliefs = jax.tree.map(
            lambda leaf: jnp.zeros((num_nodes, *leaf.shape), leaf.dtype).at[ROOT].set(leaf), belief
        )
        return cls(
            belief=beliefs,
            outcome=jnp.zeros((num_nodes, 2), dtype),
            totals=jnp.zeros((num_nodes, 2), dtype),
            children=jnp.full((num_nodes, num_actions), UNVISITED, jnp.int32),
        )

    @property
    def reward(self) -> Float[Array | np.ndarray, "*B N"]:
        """Reward of the action that leads to a node."""
        return self.outcome[..., 0]

    @property
    def is_terminal(self) -> Bool[Array | np.ndarray, "*B N"]:
        """Whether the episode has ended at a node."""
        return self.outcome[..., 1] > 0.0

    @property
    def visits(self) -> Float[Array | np.ndarray, "*B N"]:
        """Number of simulations through a node; for the root, of all simulations."""
        return self.totals[..., 0]

    @property
    def total_return(self) -> Float[Array | np.ndarray, "*B N"]:
        """Sum of the returns of these simulations, from the action that leads to the node on."""
        return self.totals[..., 1]

    def grown(self, growth: "Growth") -> "Tree":
        """The tree after a simulation."""
        # The row of the child is written even if no node is added: no parent refers to it, and the same
        # iteration of every lane writes the same row, without a scatter. Visits and returns go to a different
        # node in every lane, so these are scatters; indices past the end are dropped.
        child = growth.child
        return Tree(
            belief=jax.tree.map(lambda all, one: write_row(all, child, one), self.belief, growth.belief),
            outcome=write_row(self.outcome, child, growth.outcome),
            totals=self.totals.at[growth.nodes].add(growth.totals, mode="drop"),
            children=self.children.at[growth.parent, growth.index].set(child, mode="drop"),
        )

    def num_children(self, node: Int[Array, ""]) -> Int[Array, ""]:
        """Number of actions that have been simulated from `node`."""
        return jnp.sum(self.children[node] != UNVISITED, dtype=jnp.int32)

    def mean_return(self, nodes: Int[Array, "*K"]) -> Float[Array, "*K"]:
        """Mean return of the actions that lead to `nodes`; minus infinity for `UNVISITED`."""
        totals = self.totals[nodes]
        mean = totals[..., 1] / jnp.maximum(totals[..., 0], 1.0)
        return jnp.where(nodes == UNVISITED, -jnp.inf, mean)


class Growth(eqx.Module):
    """What a simulation adds to a tree of N nodes with A actions.

    Attributes:
        child: Node to which `belief` and `outcome` belong, whether or not it is new.
        belief: Belief of that node.
        outcome: `Tree.outcome` of that node.
        nodes: Nodes visited, the deepest first; N for levels that were not reached.
        totals: Addition to `Tree.totals` of these nodes.
        parent: Parent of the node.
        index: Index of the node among the parent's actions; A if the node is discarded.
    """

    child: Int[Array, ""]
    belief: Node
    outcome: Float[Array, "2"]
    nodes: Int[Array, "V"]
    totals: Float[Array, "V 2"]
    parent: Int[Array, ""]
    index: Int[Array, ""]

    @classmethod
    def nothing(cls, tree: Tree, num_visited: int) -> "Growth":
        """A growth that leaves a tree with only a root unchanged: zeros for a node that does not exist."""
        num_nodes, num_actions = tree.children.shape
        zero = jnp.zeros((), jnp.int32)
        return cls(
            child=zero + 1,
            belief=jax.tree.map(lambda all: jnp.zeros_like(all[ROOT]), tree.belief),
            outcome=jnp.zeros_like(tree.outcome[ROOT]),
            nodes=jnp.full((num_visited,), num_nodes, jnp.int32),
            totals=jnp.zeros((num_visited, 2), tree.totals.dtype),
            parent=zero,
            index=zero + num_actions,
        )


@jax.custom_batching.custom_vmap
def write_row(rows: Array, index: Int[Array, ""], row: Array) -> Array:
    """`rows` with one row replaced, at an index that is the same in all lanes of a batch.

    `vmap` alone would turn this into a scatter, which checks the range of its indices: two kernels on a GPU.
    """
    return jax.lax.dynamic_update_index_in_dim(rows, row, index, 0)


@write_row.def_vmap
def _write_row_of_lanes(num_lanes: int, is_batched, rows: Array, index: Array, row: Array):
    # The index differs between lanes only outside of a search, which shares it.
    if is_batched[1]:
        axes = [0 if batched else None for batched in is_batched]
        return jax.vmap(lambda rows, index, row: rows.at[index].set(row), axes)(rows, index, row), True
    if not is_batched[0]:
        rows = jnp.broadcast_to(rows, (num_lanes, *rows.shape))
    if not is_batched[2]:
        row = jnp.broadcast_to(row, (num_lanes, *row.shape))
    # The same row of every lane: one slice along axis 1 of the batch, whose axis 0 are the lanes.
    return jax.lax.dynamic_update_index_in_dim(rows, row, index, 1), True


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
    # UNVISITED is -1 and reads the last node; its mean return of minus infinity keeps it from being chosen.
    visits = jnp.maximum(tree.totals[children][:, 0], 1.0)
    of_parent = jnp.maximum(tree.totals[node][0], 1.0)
    bonus = exploration * jnp.sqrt(jnp.log(of_parent) / visits)
    return children[jnp.argmax(tree.mean_return(children) + bonus)]
