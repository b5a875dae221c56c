"""A tree of action nodes and belief nodes in flat, preallocated arrays.

Iteration i of a search adds at most one belief node and one action node, both with the index i + 1, so that
all lanes of a batch write new nodes at the same index. Where every action has one branch, an action node and
its belief node share an index, and no branches are stored.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Num

from bojax.numerics.lanes import write_row

ROOT = 0  # index of the root node
UNVISITED = ROOT  # marks an action or a branch that does not exist: nothing leads to the root

Belief = Any
"""What a planner stores for a belief node: a tree of arrays."""


Index = Int[Array, ""]
"""Index of a node."""

Totals = Float[Array, "A T"]
"""`Tree.totals` of the actions of a node."""


class Tree(eqx.Module):
    """N belief nodes with at most A actions each, and N action nodes with at most B branches each."""

    # Numbers that are written together are one array: each array costs a GPU a kernel in every iteration.
    beliefs: Belief  # beliefs, each array with a leading axis of belief nodes
    # Reward of the branch that leads to a belief node, and whether the episode has ended there
    outcome: Float[Array, "N 2"]
    # Number of visits and sum of returns of each action node; for a proposal that learns, also the sum of its
    # target and of squared deviations from the mean target. A search may count its simulations in the row of
    # the root
    totals: Float[Array, "N T"]
    children: Int[Array, "N A"]  # action node of each action of a belief node, or `UNVISITED`
    # Belief node of each branch of an action node, in order of addition, or `UNVISITED`;
    # None for one branch an action
    branches: Int[Array, "N B"] | None
    # Parameters of the action of an action node; None if the planner stores them elsewhere
    parameters: Num[Array, "N P"] | None

    @classmethod
    def rooted(
        cls,
        belief: Belief,
        iterations: int,
        num_actions: int,
        dtype,
        *,
        num_branches: int | None = None,
        parameters: Num[Array, "P"] | None = None,
        num_totals: int = 2,
    ) -> "Tree":
        """A tree with only a root, and room for the nodes of all iterations.

        A belief node has room for `num_actions` actions, and an action node for `num_branches` branches; None
        for one branch an action. `parameters` are those of any action; None if they are stored elsewhere.
        """
        num = iterations + 1

        def empty(leaf: Array) -> Array:
            return jnp.zeros((num, *leaf.shape), leaf.dtype)

        return cls(
            beliefs=jax.tree.map(lambda leaf: empty(leaf).at[ROOT].set(leaf), belief),
            outcome=jnp.zeros((num, 2), dtype),
            totals=jnp.zeros((num, num_totals), dtype),
            children=jnp.full((num, num_actions), UNVISITED, jnp.int32),
            branches=None if num_branches is None else jnp.full((num, num_branches), UNVISITED, jnp.int32),
            parameters=None if parameters is None else empty(parameters),
        )

    @property
    def reward(self) -> Float[Array | np.ndarray, "*L N"]:
        """Reward of the branch that leads to a belief node."""
        return self.outcome[..., 0]

    @property
    def is_terminal(self) -> Bool[Array | np.ndarray, "*L N"]:
        """Whether the episode has ended at a belief node."""
        return self.outcome[..., 1] > 0.0

    @property
    def visits(self) -> Float[Array | np.ndarray, "*L N"]:
        """Number of simulations through an action node."""
        return self.totals[..., 0]

    @property
    def total_return(self) -> Float[Array | np.ndarray, "*L N"]:
        """Sum of the returns of these simulations, from the action on."""
        return self.totals[..., 1]

    def grown(self, growth: "Growth") -> "Tree":
        """The tree after a simulation."""
        # The rows of new nodes are written even if no node is added: nothing refers to them then, and the
        # same iteration of every lane writes the same row, without a scatter. Totals and links are other rows
        # in every lane, so these are scatters; indices past the end are dropped.
        index, branches = growth.index, self.branches
        if branches is not None:
            branches = branches.at[growth.action, growth.branch].set(index, mode="drop")

        def with_row(rows: Array, row: Array) -> Array:
            return write_row(rows, index, row)

        return Tree(
            beliefs=jax.tree.map(with_row, self.beliefs, growth.belief),
            outcome=with_row(self.outcome, growth.outcome),
            totals=self.totals.at[growth.credited].add(growth.added, mode="drop"),
            children=self.children.at[growth.node, growth.slot].set(index, mode="drop"),
            branches=branches,
            parameters=jax.tree.map(with_row, self.parameters, growth.parameters),
        )

    def totals_of(self, actions: Int[Array, "*K"]) -> Float[Array, "*K T"]:
        """`totals` of action nodes; zeros for `UNVISITED`."""
        return jnp.where((actions != UNVISITED)[..., None], row(self.totals, actions), 0.0)

    def mean_return(self, actions: Int[Array, "*K"]) -> Float[Array, "*K"]:
        """Mean return of action nodes; minus infinity for `UNVISITED`."""
        totals = self.totals_of(actions)
        return mean_return(totals[..., 0], totals[..., 1])

    def num_children(self, node: Index) -> Int[Array, ""]:
        """Number of actions that have been simulated from the belief node `node`."""
        return jnp.sum(self.children[node] != UNVISITED, dtype=jnp.int32)

    def parameters_of(self, actions: Int[Array, "*K"]) -> Num[Array, "*K P"]:
        """Parameters of action nodes; zeros for `UNVISITED`."""
        assert self.parameters is not None
        return row(self.parameters, actions)

    def branches_of(self, action: Int[Array, ""], *place: Int[Array, ""]) -> Int[Array, "*B"]:
        """Belief nodes of all branches of an action node, or of the branch at a place."""
        assert self.branches is not None
        return row(self.branches, action, *place)

    def root_actions(self) -> "RootActions":
        """What the tree knows about the actions of its root."""
        children = self.children[ROOT]
        totals = self.totals_of(children)
        return RootActions(self.parameters_of(children), totals[:, 0], totals[:, 1])


class Growth(eqx.Module):
    """What a simulation adds to a tree of N nodes with A actions: two nodes of one index, and its returns."""

    # Index of the new nodes, an action node and a belief node, whether or not they are added
    index: Int[Array, ""]
    belief: Belief  # belief of the belief node
    outcome: Float[Array, "2"]  # `Tree.outcome` of the belief node
    credited: Int[Array, "L"]  # action nodes that the simulation passed; N for levels that were not reached
    added: Float[Array, "L T"]  # addition to `Tree.totals` of these nodes
    node: Int[Array, ""]  # belief node that the action belongs to
    slot: Int[Array, ""]  # place of the action node among the actions of `node`; A if it is not added
    # Action node that the belief node belongs to, N if it is not added; None for one branch an action
    action: Int[Array, ""] | None = None
    branch: Int[Array, ""] | None = None  # place of the belief node among the branches of `action`
    parameters: Num[Array, "P"] | None = None  # `Tree.parameters` of the action node


class RootActions(NamedTuple):
    """The actions of the root of a tree, or of several trees."""

    parameters: Num[Array, "A P"]  # parameters of each action; arbitrary for an action without visits
    visits: Float[Array, "A"]  # number of visits of each action
    returns: Float[Array, "A"]  # sum of returns of each action

    def values(self) -> Float[Array, "A"]:
        """Mean return of each action; -inf for actions without a visit."""
        return mean_return(self.visits, self.returns)

    def recommended(self, by_value: bool | Array) -> "Recommendation":
        """The action with the highest mean return, or else with the most visits."""
        values = self.values()
        slot = jnp.argmax(jnp.where(by_value, values, self.visits))
        return Recommendation(slot, self.parameters[slot], values[slot], self.visits[slot])


class Recommendation(NamedTuple):
    """An action of the root, by its place there and its parameters, with its mean return and visits."""

    slot: Int[Array, ""]
    parameters: Num[Array, "P"]
    value: Float[Array, ""]
    visits: Float[Array, ""]


def mean_return(visits: Float[Array, "*K"], returns: Float[Array, "*K"]) -> Float[Array, "*K"]:
    """Mean return of actions, from their sums of returns; minus infinity for actions without a visit."""
    return jnp.where(visits > 0.0, returns / jnp.maximum(visits, 1.0), -jnp.inf)


def upper_bound(
    visits: Float[Array, "*K"],
    returns: Float[Array, "*K"],
    at_node: Float[Array, ""],
    exploration: Float[Array, ""],
) -> Float[Array, "*K"]:
    """UCT (4.1) of the actions of a node with `at_node` visits; minus infinity for actions without a visit.

    It is the mean return plus `exploration` sqrt(ln n_p / n_i). The factor 2 under the square root in
    Algorithm 2 is absorbed by `exploration`.
    """
    bonus = exploration * jnp.sqrt(jnp.log(jnp.maximum(at_node, 1.0)) / jnp.maximum(visits, 1.0))
    return mean_return(visits, returns) + bonus


def best_by_mean(tree: Tree) -> Index:
    """Child of the root with the highest mean return.

    Deviation: Algorithms 2 and 4 choose the largest sum of returns, which for negative returns favours the
    least visited child.
    """
    children = tree.children[ROOT]
    return children[jnp.argmax(tree.mean_return(children))]


def best_by_uct(tree: Tree, node: Index, exploration: Float[Array, ""]) -> Index:
    """Child of `node` with the highest `upper_bound`, where every action has one branch."""
    children = tree.children[node]
    totals = tree.totals_of(children)
    bounds = upper_bound(totals[:, 0], totals[:, 1], tree.totals[node][0], exploration)
    return children[jnp.argmax(bounds)]


def row(rows: Array, *index: Int[Array, "..."]) -> Array:
    """A row of an array, at an index that is known to be in range: without the check of a plain index."""
    return rows.at[index].get(mode="promise_in_bounds")
