"""Tree search over a finite set of actions: SBO, BO-POMDP and plain MCTS (Algorithm 2)."""

from operator import methodcaller

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.motions.base import DiscreteMotions, Path
from bojax.numerics.lanes import write_row
from bojax.planning.search import PlanDraws, Proposal, TreeSearch
from bojax.planning.tree import UNVISITED, Index, Tree, best_by_uct
from bojax.problems.base import Objective


class DiscreteMemory(eqx.Module):
    """The action that leads to each node, and the paths of all actions."""

    paths: Float[Array, "A S 3"]  # paths of the actions
    action: Int[Array, "N"]  # action that leads to each node


class DiscreteTreeSearch(TreeSearch[DiscreteMotions]):
    """A node tries its untried actions first, in random order, then follows the upper confidence bound.

    Sets of actions of all sizes share a program: nodes have room for the largest.

    Settings: `bojax.planning.settings.SBO` and `BOPOMDP`.
    """

    motions: DiscreteMotions = eqx.field(converter=methodcaller("with_room"))
    exploration: Float[Array, ""]
    objective: Objective = None

    @property
    @override
    def num_actions(self) -> int:
        return self.motions.num_actions

    @override
    def begin(self, key: Key[Array, ""], dtype) -> tuple[DiscreteMemory, PlanDraws]:
        key_rollout, key_order = jax.random.split(key)
        shape, count = (self.iterations, self.depth - 1), self.motions.count
        # `randint` with a bound that is not constant takes seconds to compile.
        rollout = jax.random.uniform(key_rollout, shape, dtype) * count.astype(dtype)
        draws = PlanDraws(
            rollout=jnp.minimum(rollout.astype(jnp.int32), count - 1),
            untried=jax.random.uniform(key_order, (self.iterations, self.num_actions), dtype),
        )
        memory = DiscreteMemory(
            paths=self.motions.paths(), action=jnp.zeros((self.iterations + 1,), jnp.int32)
        )
        return memory, draws

    @override
    def view(self, tree: Tree, memory: DiscreteMemory, node: Index) -> Index:
        """The child to descend to."""
        is_open = tree.num_children(node) < self.motions.count
        return jnp.where(is_open, UNVISITED, best_by_uct(tree, node, self.exploration))

    @override
    def propose(
        self, tree: Tree, memory: DiscreteMemory, node: Index, view: Int[Array, ""], draws: PlanDraws
    ) -> Proposal:
        # Lines 16-17 of Algorithm 2: any untried action, chosen by random priorities in [0, 1). Places past
        # the size of the set only make sets of all sizes one program.
        is_untried = tree.children[node] == UNVISITED
        is_untried &= jnp.arange(self.num_actions, dtype=jnp.int32) < self.motions.count
        action = jnp.argmax(jnp.where(is_untried, draws.untried, -1.0)).astype(jnp.int32)
        return Proposal(path=memory.paths[action], index=action, update=None)

    @override
    def learn(
        self, memory: DiscreteMemory, child: Index, proposal: Proposal, is_new: Bool[Array, ""]
    ) -> DiscreteMemory:
        return DiscreteMemory(memory.paths, write_row(memory.action, child, proposal.index))

    @override
    def path_of(self, memory: DiscreteMemory, child: Index) -> Path:
        return memory.paths[memory.action[child]]
