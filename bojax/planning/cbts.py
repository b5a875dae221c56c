"""Continuous belief tree search: nodes choose new actions by Bayesian optimisation (Algorithms 3-4)."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.acquisition.functions import Acquisition
from bojax.acquisition.maximise import best_candidate, refine
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel
from bojax.motions.base import ContinuousMotions, Path
from bojax.numerics.quasirandom import shifted_kronecker
from bojax.planning.search import Proposal, TreeSearch
from bojax.planning.tree import UNVISITED, Tree, best_by_mean, best_by_uct
from bojax.problems.base import Objective

Scaling = Literal["standardise", "rank", "none"]


class NodeModels(eqx.Module):
    """The Gaussian processes of all nodes, from action parameters to rewards.

    An observation of a node's process is an action of that node, so it is stored with the child that the
    action leads to: the rows that it appended to the inverse Cholesky factor and to the whitened covariances
    of the candidates, and its parameters (its value is the tree's). That takes N (A + C) numbers, where
    factors and covariances for every node would take N A (A + C); and a new action costs A C products,
    where whitening the candidates anew would take A^2 C.

    Attributes:
        candidates: Parameters that acquisitions are maximised over, and that rollouts draw from.
        paths: Their paths.
        params: Parameters of the action that leads to each node.
        row: Row of that action in the inverse Cholesky factor of its parent's process.
        whitened: Row of that action in the whitened covariances of the candidates; zero in the last row.
        has_converged: Whether that action was nearly the one before it.
    """

    candidates: Float[Array, "C D"]
    paths: Float[Array, "C S 3"]
    params: Float[Array, "N D"]
    row: Float[Array, "N A"]
    whitened: Float[Array, "N+1 C"]
    has_converged: Bool[Array, "N"]


class CBTSDraws(eqx.Module):
    """Random numbers of a plan, by iteration.

    Attributes:
        rollout: Indices of the candidates that the rollout follows.
        initial: Index of the candidate that a node with fewer than `num_initial` actions tries.
    """

    rollout: Int[Array, "... H"]
    initial: Int[Array, "..."]


class NodeModelUpdate(eqx.Module):
    """What a new action adds to the Gaussian process of its node, see `NodeModels`."""

    params: Float[Array, "D"]
    row: Float[Array, "A"]
    whitened: Float[Array, "C"]
    has_converged: Bool[Array, ""]


class ContinuousBeliefTreeSearch(TreeSearch[NodeModels, CBTSDraws, NodeModelUpdate, ContinuousMotions]):
    """CBTS; with kernel trajectories, kCBTS.

    A node with fewer than `max_actions` actions gets a new one, the maximiser of the acquisition under the
    node's Gaussian process from action parameters to immediate rewards; otherwise the search descends to
    the child of the best upper confidence bound.

    Attributes:
        motions: Trajectories and their parameters.
        kernel: Covariance of the node's rewards, over parameters in [-1, 1]^D.
        acquisition: How a new action is chosen.
        noise_variance: Noise of the node's process, relative to the variance of its rewards.
        exploration: kappa_MC of (4.1), in units of the return.
        convergence: Stop generating actions at a node once two in a row are closer than this; 0 for never.
        discount: Discount a step.
        iterations: Simulations a plan.
        depth: Actions to the horizon.
        max_actions: A_max, the most actions of a node.
        num_candidates: Parameters among which the acquisition is maximised, drawn anew for each plan.
        num_initial: First actions of a node that are random candidates instead.
        refine_steps: Gradient steps from the best candidate; 0 for none.
        scaling: How a node's rewards enter its process: `"standardise"` to mean 0 and variance 1, `"rank"`
            for their ranks spread evenly over [-1, 1], or `"none"`.
        objective: What to maximise, if not the problem's own task.
    """

    motions: ContinuousMotions
    kernel: Kernel
    acquisition: Acquisition
    noise_variance: Float[Array, ""]
    exploration: Float[Array, ""]
    convergence: Float[Array, ""]
    discount: Float[Array, ""]
    iterations: int = eqx.field(static=True)
    depth: int = eqx.field(static=True)
    max_actions: int = eqx.field(static=True)
    num_candidates: int = eqx.field(static=True)
    num_initial: int = eqx.field(static=True)
    refine_steps: int = eqx.field(static=True)
    scaling: Scaling = eqx.field(static=True)
    objective: Objective = None

    @property
    def num_actions(self) -> int:
        """See `TreeSearch`."""
        return self.max_actions

    def begin(self, key: Key[Array, ""], dtype) -> tuple[NodeModels, CBTSDraws]:
        """See `TreeSearch`."""
        key_candidates, key_rollout, key_initial = jax.random.split(key, 3)
        candidates = shifted_kronecker(key_candidates, self.num_candidates, self.motions.num_params, dtype)
        num_nodes = self.iterations + 1
        memory = NodeModels(
            candidates=candidates,
            paths=jax.vmap(self.motions.path)(candidates),
            params=jnp.zeros((num_nodes, self.motions.num_params), dtype),
            row=jnp.zeros((num_nodes, self.max_actions), dtype),
            whitened=jnp.zeros((num_nodes + 1, self.num_candidates), dtype),
            has_converged=jnp.zeros((num_nodes,), bool),
        )
        shape = (self.iterations, self.depth - 1)
        draws = CBTSDraws(
            rollout=jax.random.randint(key_rollout, shape, 0, self.num_candidates),
            initial=jax.random.randint(key_initial, (self.iterations,), 0, self.num_candidates),
        )
        return memory, draws

    def rollout(self, memory: NodeModels, draws: CBTSDraws) -> Float[Array, "H S 3"]:
        """See `TreeSearch`."""
        return memory.paths[draws.rollout]

    def select(self, tree: Tree, memory: NodeModels, node: Int[Array, ""]) -> Int[Array, ""]:
        """See `TreeSearch`."""
        children = tree.children[node]
        exists = children != UNVISITED
        is_full = jnp.all(exists) | jnp.any(exists & memory.has_converged[children])
        return jnp.where(is_full, best_by_uct(tree, node, self.exploration), UNVISITED)

    def propose(
        self, tree: Tree, memory: NodeModels, node: Int[Array, ""], draws: CBTSDraws
    ) -> Proposal[NodeModelUpdate]:
        """See `TreeSearch`."""
        model, best = self._model(tree, memory, node)
        is_initial = model.count < self.num_initial
        # UNVISITED is -1: the last row, which no child has, stays zero.
        whitened_all = memory.whitened[tree.children[node]]
        choice = best_candidate(self.acquisition, model, best, memory.candidates, whitened_all)
        choice = jnp.where(is_initial, draws.initial, choice)
        params, path, whitened = memory.candidates[choice], memory.paths[choice], whitened_all[:, choice]
        if self.refine_steps > 0:
            refined = refine(self.acquisition, model, best, params, self.refine_steps)
            params = jnp.where(is_initial, params, refined)
            path, whitened = self.motions.path(params), model.whiten(params[None, :])[:, 0]
        previous = model.x[jnp.maximum(model.count - 1, 0)]
        distance = jnp.sqrt(jnp.sum((params - previous) ** 2))
        row = model.next_row(params, whitened)
        update = NodeModelUpdate(
            params=params,
            row=row,
            whitened=model.next_whitened(params, whitened, row, memory.candidates, whitened_all),
            has_converged=(model.count > 0) & (distance < self.convergence),
        )
        return Proposal(path=path, index=model.count, update=update)

    def learn(
        self,
        memory: NodeModels,
        child: Int[Array, ""],
        proposal: Proposal[NodeModelUpdate],
        is_new: Bool[Array, ""],
    ) -> NodeModels:
        """See `TreeSearch`."""
        del is_new
        update = proposal.update
        return NodeModels(
            candidates=memory.candidates,
            paths=memory.paths,
            params=memory.params.at[child].set(update.params),
            row=memory.row.at[child].set(update.row),
            whitened=memory.whitened.at[child].set(update.whitened),
            has_converged=memory.has_converged.at[child].set(update.has_converged),
        )

    def _model(
        self, tree: Tree, memory: NodeModels, node: Int[Array, ""]
    ) -> tuple[GaussianProcess, Float[Array, ""]]:
        """The Gaussian process of a node, and the best value it has seen."""
        children = tree.children[node]
        exists = children != UNVISITED
        count = jnp.sum(exists, dtype=jnp.int32)
        rewards = _scale(tree.reward[children], exists, self.scaling)
        model = GaussianProcess(
            kernel=self.kernel,
            noise_variance=self.noise_variance,
            x=jnp.where(exists[:, None], memory.params[children], 0.0),
            y=jnp.where(exists, rewards, 0.0),
            inverse_cholesky=jnp.where(exists[:, None], memory.row[children], 0.0),
            count=count,
        )
        return model, jnp.max(jnp.where(exists, rewards, -jnp.inf))

    def recommend(self, tree: Tree, memory: NodeModels) -> Int[Array, ""]:
        """See `TreeSearch`."""
        del memory
        return best_by_mean(tree)

    def path_of(self, memory: NodeModels, child: Int[Array, ""]) -> Path:
        """See `TreeSearch`."""
        return self.motions.path(memory.params[child])


def _scale(rewards: Float[Array, "A"], exists: Bool[Array, "A"], scaling: Scaling) -> Float[Array, "A"]:
    """A node's rewards as its process sees them; meaningless where `exists` is false."""
    number = jnp.maximum(jnp.sum(exists), 1).astype(rewards.dtype)
    if scaling == "none":
        return rewards
    if scaling == "rank":
        # Twice the mean rank: one for each reward below and one for each reward not above, itself included.
        below = jnp.sum(exists[None, :] & (rewards[None, :] < rewards[:, None]), axis=1)
        not_above = jnp.sum(exists[None, :] & (rewards[None, :] <= rewards[:, None]), axis=1)
        return (below + not_above).astype(rewards.dtype) / number - 1.0
    mean = jnp.sum(jnp.where(exists, rewards, 0.0)) / number
    variance = jnp.sum(jnp.where(exists, (rewards - mean) ** 2, 0.0)) / number
    # Equal rewards say nothing about the surface: they stay 0.
    return (rewards - mean) / jnp.where(variance > 1e-12 * mean**2, jnp.sqrt(variance), 1.0)
