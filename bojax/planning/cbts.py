"""Continuous belief tree search: nodes choose new actions by Bayesian optimisation (Algorithms 3-4)."""

import math
from dataclasses import replace
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.acquisition.functions import Acquisition
from bojax.acquisition.maximise import best_candidate, refine
from bojax.models.checks import check_takes
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel
from bojax.motions.base import ContinuousMotions, Path
from bojax.numerics.lanes import write_row
from bojax.numerics.pallas import either
from bojax.numerics.quasirandom import shifted_kronecker
from bojax.planning import cbts_kernel
from bojax.planning.search import PlanDraws, Proposal, TreeSearch
from bojax.planning.tree import ROOT, UNVISITED, Index, Tree, best_by_uct
from bojax.problems.base import Belief, Objective
from bojax.problems.path_problem import PathProblem
from bojax.results.schema import Column, Table

Scaling = Literal["standardise", "rank", "none"]


class NodeModels(eqx.Module):
    """The Gaussian processes of all nodes, from action parameters to rewards.

    The observations of a node's process are the node's actions. Each one is stored with the child that the
    action leads to: its parameters, and the rows that it appended to the inverse Cholesky factor and to the
    whitened covariances of the candidates; its value is the reward in the tree. The row of the root is zero.
    """

    # One row a node: N (A + C) numbers instead of N A (A + C) for a factor and covariances of every node.
    # Parameters and row are one array, since each array costs a GPU a kernel in every iteration.
    # Parameters over which acquisitions are maximised and from which rollouts draw
    candidates: Float[Array, "C D"]
    paths: Float[Array, "C S 3"]  # paths of the candidates
    # Parameters and row in the factor of the action that leads to each node, see `NodeAction`
    actions: Float[Array, "N K"]
    whitened: Float[Array, "N C"]  # row of the same action in the whitened covariances of the candidates
    # Whether the same action was within `convergence` of the action before it
    has_converged: Bool[Array, "N"]

    @property
    def params(self) -> Float[Array | np.ndarray, "N D"]:
        """Parameters of the action that leads to each node."""
        return self.actions[:, : self.candidates.shape[1]]

    def children(self, nodes: Int[Array, "A"]) -> "NodeAction":
        """The actions that lead to the children of a node; zeros for `UNVISITED`."""
        # UNVISITED reads the row of the root, to which no action leads: it stays zero.
        params, row = jnp.split(self.actions[nodes], [self.candidates.shape[1]], axis=-1)
        return NodeAction(params, row, self.whitened[nodes])


class NodeAction(eqx.Module):
    """What an action adds to the Gaussian process of its node, see `NodeModels`."""

    params: Float[Array, "*A D"]  # parameters of the action
    row: Float[Array, "*A A"]  # its row in the inverse Cholesky factor
    whitened: Float[Array, "*A C"]  # its row in the whitened covariances of the candidates


class NewAction(NodeAction):
    """A new action, and whether it was within `convergence` of the action before it."""

    has_converged: Bool[Array, ""]


ROOM = 20  # number of actions for which a node has room at least: A_max of the thesis


def _places(max_actions: int | Float[Array, ""] | Bool[Array, "A"]) -> Bool[Array, "A"]:
    if isinstance(max_actions, Array) and max_actions.ndim:
        return max_actions
    most = int(max_actions)
    return jnp.arange(max(most, ROOM)) < most


class ContinuousBeliefTreeSearch(TreeSearch[ContinuousMotions]):
    """CBTS; with kernel trajectories, kCBTS.

    A node with fewer than `max_actions` actions adds the action that maximises the acquisition under the
    node's Gaussian process from action parameters to immediate rewards. Otherwise the search descends to the
    child with the highest upper confidence bound (4.1).

    All values of `max_actions` up to `ROOM` share a program: the field is a mask over the places of a node,
    true for the first `max_actions`.

    Settings: `bojax.planning.settings.KCBTS` and `CBTS`.
    """

    motions: ContinuousMotions
    kernel: Kernel
    acquisition: Acquisition
    noise_variance: Float[Array, ""]
    exploration: Float[Array, ""]
    convergence: Float[Array, ""]
    max_actions: Bool[Array, "A"] = eqx.field(converter=_places)
    num_candidates: int = eqx.field(static=True)
    num_initial: int = eqx.field(static=True)
    refine_steps: int = eqx.field(static=True)
    scaling: Scaling = eqx.field(static=True)
    objective: Objective = None
    measures_shortfall: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        num_params, dtype = self.motions.num_params, self.motions.length.dtype
        check_takes("kernel", self.kernel, 2, num_params, dtype, "the parameters of the motions")

    @property
    @override
    def num_actions(self) -> int:
        return self.max_actions.size

    @override
    def search(self, key: Key[Array, ""], problem: PathProblem, belief: Belief) -> tuple[Tree, NodeModels]:
        """The tree and the planner's memory after all iterations; on a GPU, a kernel may find them.

        Rows of nodes that the root does not lead to are undefined.
        """
        by_xla = super().search
        if type(self) is not ContinuousBeliefTreeSearch or not cbts_kernel.is_used(self, problem):
            return by_xla(key, problem, belief)

        def by_kernel(key: Key[Array, ""], belief: Belief) -> tuple[Tree, NodeModels]:
            key, _ = jax.random.split(key)  # the second one, of simulations, draws nothing here
            memory, draws = self.begin(key, self.discount.dtype)
            tree, found = cbts_kernel.search(self, problem, belief, memory, draws)
            return tree, replace(memory, **found)

        return either(True, by_kernel, lambda key, belief: by_xla(key, problem, belief), key, belief)

    @override
    def begin(self, key: Key[Array, ""], dtype) -> tuple[NodeModels, PlanDraws]:
        keys = jax.random.split(key, 3)
        candidates = shifted_kronecker(keys[0], self.num_candidates, self.motions.num_params, dtype)
        num_nodes = self.iterations + 1
        memory = NodeModels(
            candidates=candidates,
            paths=jax.vmap(self.motions.path)(candidates),
            actions=jnp.zeros((num_nodes, self.motions.num_params + self.num_actions), dtype),
            whitened=jnp.zeros((num_nodes, self.num_candidates), dtype),
            has_converged=jnp.zeros((num_nodes,), bool),
        )
        # Both sets of numbers come from one call, since random draws are slow to compile. As every element is
        # drawn by its position, a longer draw begins with the numbers of a shorter one.
        size = self.iterations * max(1, self.depth - 1)
        numbers = jax.vmap(lambda key: jax.random.randint(key, (size,), 0, self.num_candidates))(keys[1:])
        shape = (self.iterations, self.depth - 1)
        # A node with fewer than `num_initial` actions tries the candidates of the second set.
        draws = PlanDraws(
            rollout=numbers[0, : math.prod(shape)].reshape(shape), untried=numbers[1, : self.iterations]
        )
        return memory, draws

    @override
    def view(self, tree: Tree, memory: NodeModels, node: Index) -> Index:
        """The child to descend to."""
        children = tree.children[node]
        exists = children != UNVISITED
        # Line 12 of Algorithm 4, with A_max as a mask: a place that may not be taken counts as taken.
        is_full = jnp.all(exists | ~self.max_actions) | jnp.any(exists & memory.has_converged[children])
        return jnp.where(is_full, best_by_uct(tree, node, self.exploration), UNVISITED)

    @override
    def propose(
        self, tree: Tree, memory: NodeModels, node: Index, view: Int[Array, ""], draws: PlanDraws
    ) -> Proposal:
        # Line 3 of Algorithm 3: the candidate of highest acquisition (4.2). The candidates are the same at
        # all nodes, so that their whitened covariances grow by a row an action: A C products, where whitening
        # them again would take A^2 C.
        known = memory.children(tree.children[node])
        model, best = self._model(tree, known, node)
        # The first actions of a node are random: a single reward, standardised, carries no information.
        is_initial = model.count < self.num_initial
        choice = best_candidate(self.acquisition, model, best, memory.candidates, known.whitened)
        choice = jnp.where(is_initial, draws.untried, choice)
        params, path, whitened = memory.candidates[choice], memory.paths[choice], known.whitened[:, choice]
        if self.refine_steps > 0:
            # A refined action is no candidate: its path and its covariances have to be computed.
            refined = refine(self.acquisition, model, best, params, self.refine_steps)
            params = jnp.where(is_initial, params, refined)
            path, whitened = self.motions.path(params), model.whiten(params[None, :])[:, 0]
        # The search has converged at this node once two successive actions are (nearly) the same.
        previous = model.x[jnp.maximum(model.count - 1, 0)]
        distance = jnp.sqrt(jnp.sum((params - previous) ** 2))
        # Line 6 of Algorithm 3 without a refit: the rows that the new observation appends. They do not depend
        # on its reward, which the tree stores once it is simulated.
        action = NewAction(
            params=params,
            row=model.next_row(params, whitened),
            whitened=model.next_whitened(params, whitened, memory.candidates, known.whitened),
            has_converged=(model.count > 0) & (distance < self.convergence),
        )
        return Proposal(path=path, index=model.count, update=action)

    @override
    def learn(
        self, memory: NodeModels, child: Index, proposal: Proposal, is_new: Bool[Array, ""]
    ) -> NodeModels:
        action: NewAction = proposal.update
        row = jnp.concatenate([action.params, action.row])
        return replace(
            memory,
            actions=write_row(memory.actions, child, row),
            whitened=write_row(memory.whitened, child, action.whitened),
            has_converged=write_row(memory.has_converged, child, action.has_converged),
        )

    def _model(self, tree: Tree, known: NodeAction, node: Index) -> tuple[GaussianProcess, Float[Array, ""]]:
        """The Gaussian process of a node with these actions, and the best value observed."""
        # Assembled anew from the rows of the children. Rewards are scaled by all of the node's rewards, so
        # that every new one changes the others: only rows of the factor, which are free of values, can be
        # kept.
        children = tree.children[node]
        exists = children != UNVISITED
        count = jnp.sum(exists, dtype=jnp.int32)
        rewards = self.scaled(tree.outcome[children][:, 0], exists)
        model = GaussianProcess(
            kernel=self.kernel,
            noise_variance=self.noise_variance,
            x=known.params,
            y=jnp.where(exists, rewards, 0.0),
            inverse_cholesky=known.row,
            count=count,
            num_ignored=jnp.zeros((), jnp.int32),
        )
        return model, jnp.max(jnp.where(exists, rewards, -jnp.inf))

    def scaled(self, rewards: Float[Array, "A"], exists: Bool[Array, "A"]) -> Float[Array, "A"]:
        """Scaled rewards of the actions of a node; undefined where `exists` is false."""
        number = jnp.maximum(jnp.sum(exists), 1).astype(rewards.dtype)
        if self.scaling == "none":
            return rewards
        if self.scaling == "rank":
            # Twice the mean rank of a reward: how many are smaller, plus how many are not larger (with
            # itself).
            below = jnp.sum(exists[None, :] & (rewards[None, :] < rewards[:, None]), axis=1)
            not_above = jnp.sum(exists[None, :] & (rewards[None, :] <= rewards[:, None]), axis=1)
            return (below + not_above).astype(rewards.dtype) / number - 1.0
        mean = jnp.sum(jnp.where(exists, rewards, 0.0)) / number
        variance = jnp.sum(jnp.where(exists, (rewards - mean) ** 2, 0.0)) / number
        # Equal rewards carry no information about the surface: they are scaled to 0.
        return (rewards - mean) / jnp.where(variance > 1e-12 * mean**2, jnp.sqrt(variance), 1.0)

    @property
    @override
    def run_columns(self) -> Table:
        return (_SHORTFALL,) if self.measures_shortfall else ()

    @override
    def measure(
        self, problem: PathProblem, belief: Belief, tree: Tree, memory: NodeModels
    ) -> dict[str, Float[Array, ""]]:
        """How close the actions of the root before the last one come to the best candidate.

        Section 4.7.1: the continuity of rewards "allows BO to find optimal actions before trying A_max
        actions". Bayesian optimisation chooses among the candidates, so that the best of them is the optimum.
        The shortfall of the best of the first A_max - 1 actions is a share of the lead of this optimum over
        the median candidate.
        """
        if not self.measures_shortfall:
            return {}
        rewards = self.candidate_rewards(problem, belief, memory)
        children = tree.children[ROOT]
        places = jnp.arange(self.num_actions, dtype=jnp.int32)
        is_early = (children != UNVISITED) & (places < jnp.sum(self.max_actions, dtype=jnp.int32) - 1)
        found = jnp.max(jnp.where(is_early, tree.reward[children], -jnp.inf))
        best = jnp.max(rewards)
        lead = best - jnp.median(rewards)
        return {"shortfall": jnp.where(lead > 0.0, (best - found) / jnp.where(lead > 0.0, lead, 1.0), 0.0)}

    def candidate_rewards(
        self, problem: PathProblem, belief: Belief, memory: NodeModels
    ) -> Float[Array, "C"]:
        """The immediate rewards of all candidates at the root."""
        root, node = problem.with_objective(self.objective).root(belief, self.depth)
        # The key draws what is observed on the path. The reward of the path itself does not depend on it.
        key = jax.random.key(0)
        simulate = lambda path: problem.simulate(key, root, node, path[None], self.objective)  # noqa: E731
        return jax.vmap(simulate)(memory.paths).rewards[:, 0]

    @override
    def path_of(self, memory: NodeModels, child: Index) -> Path:
        params = memory.params[child]
        if self.refine_steps > 0:
            return self.motions.path(params)
        # The action is one of the candidates, whose paths are known: half as many paths to compile.
        return memory.paths[jnp.argmax(jnp.all(memory.candidates == params[None, :], axis=1))]


_SHORTFALL = Column(
    "shortfall",
    "float64",
    "",
    "mean over the steps of the reward by which the best of the first A_max - 1 actions of the root falls "
    "short of the best candidate, as a share of the lead of that over the median candidate",
    nullable=True,
)
