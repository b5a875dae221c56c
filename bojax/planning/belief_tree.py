"""A tree of action nodes and belief nodes in flat, preallocated arrays.

Iteration i of a search adds at most the belief node i + 1 and the action node i, so that all lanes of a batch
write new nodes at the same index.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Num

from bojax.planning.tree import ROOT, write_row

Belief = Any
"""What a planner stores for a belief node: a tree of arrays."""


class BeliefTree(eqx.Module):
    """N + 1 belief nodes with at most A actions each, and N action nodes with at most B branches each.

    Attributes:
        beliefs: Beliefs, each array with a leading axis of belief nodes.
        outcome: Reward of the branch that leads to a belief node, and whether the episode has ended there.
        totals: Number of visits and sum of returns of each action of a belief node; for a proposal that
            learns, also the sum of its target and of squared deviations from the mean target. Actions that
            were never visited have zeros. All actions of a node are one row, so that a descent reads one row
            a level.
        children: Action node of each action of a belief node.
        branches: Belief node of each branch of an action node, in the order in which they were added.
        parameters: Parameters of the action of an action node.
    """

    beliefs: Belief
    outcome: Float[Array, "V 2"]
    totals: Float[Array, "V A T"]
    children: Int[Array, "V A"]
    branches: Int[Array, "N B"]
    parameters: Num[Array, "N P"]

    @classmethod
    def rooted(
        cls,
        belief: Belief,
        parameters: Num[Array, "P"],
        iterations: int,
        num_actions: int,
        num_branches: int,
        num_totals: int = 2,
    ) -> "BeliefTree":
        """A tree with only a root; `parameters` are those of any action."""
        dtype = jax.tree.leaves(belief)[0].dtype
        return cls(
            beliefs=jax.tree.map(
                lambda leaf: jnp.zeros((iterations + 1, *leaf.shape), leaf.dtype).at[ROOT].set(leaf), belief
            ),
            outcome=jnp.zeros((iterations + 1, 2), dtype),
            totals=jnp.zeros((iterations + 1, num_actions, num_totals), dtype),
            children=jnp.zeros((iterations + 1, num_actions), jnp.int32),
            branches=jnp.zeros((iterations, num_branches), jnp.int32),
            parameters=jnp.zeros((iterations, *parameters.shape), parameters.dtype),
        )

    def grown(self, growth: "Growth") -> "BeliefTree":
        """The tree with a new branch, and with the action node that it belongs to if that is new."""
        # The new rows are written in every case: no node refers to them unless the writes into `children` and
        # `branches`, whose indices are past the end if masked, make it so.
        i = growth.iteration
        num_beliefs, num_actions = self.children.shape
        belief = jnp.where(growth.is_new_branch, growth.node, num_beliefs)
        slot = jnp.where(growth.is_new_action, growth.slot, num_actions)
        action = jnp.where(growth.is_new_branch, growth.action, self.branches.shape[0])
        return BeliefTree(
            beliefs=jax.tree.map(lambda all, one: write_row(all, i + 1, one), self.beliefs, growth.belief),
            outcome=write_row(self.outcome, i + 1, growth.outcome),
            totals=self.totals,
            children=self.children.at[belief, slot].set(i, mode="drop"),
            branches=self.branches.at[action, growth.branch].set(i + 1, mode="drop"),
            parameters=write_row(self.parameters, i, growth.parameters),
        )

    def root_actions(self) -> "RootActions":
        """What the tree knows about the actions of its root."""
        totals = self.totals[ROOT]
        return RootActions(self.parameters[self.children[ROOT]], totals[:, 0], totals[:, 1])


class RootActions(NamedTuple):
    """The actions of the root of a tree, or of several trees.

    Attributes:
        parameters: Parameters of each action; those of an action without a visit may be any.
        visits: Number of visits of each action.
        returns: Sum of returns of each action.
    """

    parameters: Num[Array, "A P"]
    visits: Float[Array, "A"]
    returns: Float[Array, "A"]

    def values(self) -> Float[Array, "A"]:
        """Mean return of each action; -inf for actions without a visit."""
        return jnp.where(self.visits > 0.0, self.returns / jnp.maximum(self.visits, 1.0), -jnp.inf)

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


class Growth(eqx.Module):
    """What an iteration adds to a tree.

    Attributes:
        iteration: The iteration.
        belief: Belief of the new belief node.
        outcome: `BeliefTree.outcome` of the new belief node.
        parameters: Parameters of the new action node.
        node: Belief node at which the descent ended.
        slot: Position of the action among the actions of that node.
        action: Action node of the action.
        branch: Position of the new branch among the branches of the action.
        is_new_action: Whether an action node is added.
        is_new_branch: Whether a belief node is added.
    """

    iteration: Int[Array, ""]
    belief: Belief
    outcome: Float[Array, "2"]
    parameters: Num[Array, "P"]
    node: Int[Array, ""]
    slot: Int[Array, ""]
    action: Int[Array, ""]
    branch: Int[Array, ""]
    is_new_action: Bool[Array, ""]
    is_new_branch: Bool[Array, ""]


def row(rows: Array, *index: Int[Array, "..."]) -> Array:
    """A row of an array, at an index that is known to be in range: without the check of a plain index."""
    return rows.at[index].get(mode="promise_in_bounds")


_ROUNDING = 32
"""Distance from a whole number, in units of the last place, that is taken for an error of a power."""


class Widening(eqx.Module):
    """Progressive widening: another child is added iff their number is at most k n^alpha after n visits.

    Attributes:
        coefficient: The factor k.
        exponent: The exponent alpha, in [0, 1].
    """

    coefficient: Float[Array, ""]
    exponent: Float[Array, ""]

    def thresholds(self, capacity: int) -> Float[Array, "C"]:
        """Visits after which child j may be added: max(j, (j / k)^(1 / alpha)).

        With alpha <= 1, k n^alpha is the slower of the two, once it has fallen behind n: the rule adds one
        child a visit until then, and child j at the first visit n with j <= k n^alpha from then on. So the
        number of children is a function of the visits, which no node has to store; where equal observations
        share a branch, there may be fewer.
        """
        index = jnp.arange(capacity, dtype=self.coefficient.dtype)
        # The first child needs no visit: 0^0 would be 1.
        needed = jnp.where(index > 0.0, (index / self.coefficient) ** (1.0 / self.exponent), 0.0)
        # A power is rounded differently on each device; at a whole number, that would cost a visit.
        whole = jnp.round(needed)
        needed = jnp.where(
            abs(needed - whole) <= _ROUNDING * jnp.finfo(needed.dtype).eps * whole, whole, needed
        )
        return jnp.maximum(index, needed)


def capacity(coefficient: float, exponent: float, visits: int) -> int:
    """Largest number of children after `visits` visits."""
    return int(min(visits, coefficient * max(visits - 1, 0) ** exponent + 1))
