"""How a belief search proposes a new action of a belief node."""

import abc
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.planning.tree import Index, Totals, Tree, mean_return, row
from bojax.problems.actions import ActionSpace

Target = Literal["reward", "return"]
"""What a proposal learns of an action: its mean immediate reward, or the mean return of simulations."""


class Proposal(eqx.Module):
    """A rule that proposes the parameters of a new action."""

    @property
    def target(self) -> Target | None:
        """The target whose sum and deviations `totals` has too; None for none."""
        return None

    @abc.abstractmethod
    def __call__(
        self, key: Key[Array, ""], space: ActionSpace, tree: Tree, node: Index, totals: Totals
    ) -> Float[Array, "P"]:
        """Parameters of a new action of `node`, whose actions have the visits and returns `totals`."""


class RandomProposal(Proposal):
    """A random action of the space."""

    @override
    def __call__(
        self, key: Key[Array, ""], space: ActionSpace, tree: Tree, node: Index, totals: Totals
    ) -> Float[Array, "P"]:
        return space.sample(key)


class VoronoiProposal(Proposal):
    """Voronoi progressive widening: a random action, or one near the best action so far.

    Lim, Tomlin and Sunberg, Voronoi progressive widening (CDC 2021), Algorithm 1. Candidates are drawn from a
    Gaussian about the action of the highest mean return. The first that is accepted lies in the Voronoi cell
    of that action, or within `radius` of it; if none is, the candidate that is closest to it is proposed.

    Deviation: distances are between parameters, and candidates are clipped to [-1, 1].
    """

    probability: Float[Array, ""]  # probability of a random action
    variance: Float[Array, "P"]  # variance of the Gaussian, for each parameter, or one number for all
    radius: Float[Array, ""]  # distance within which a candidate is accepted at once
    max_candidates: int = eqx.field(static=True)  # number of candidates

    @override
    def __call__(
        self, key: Key[Array, ""], space: ActionSpace, tree: Tree, node: Index, totals: Totals
    ) -> Float[Array, "P"]:
        if (num := self.variance.shape[0]) not in (1, space.size):
            raise ValueError(
                f"planner.proposal.variance: got {num} numbers; allowed: 1, or {space.size}, one for each "
                "parameter of an action"
            )
        key_choice, key_random, key_candidates = jax.random.split(key, 3)
        actions = tree.parameters_of(row(tree.children, node))
        visits, returns = totals[:, 0], totals[:, 1]
        exists = visits > 0.0
        best = jnp.argmax(mean_return(visits, returns))

        shape = self.max_candidates, actions.shape[1]
        offsets = jax.random.normal(key_candidates, shape, actions.dtype) * jnp.sqrt(self.variance)[None]
        candidates = jnp.clip(actions[best][None] + offsets, -1.0, 1.0)
        # Parameter by parameter: on a CPU, a sum over such a short axis does not vectorise.
        parameters = zip(candidates.T, actions.T, strict=True)
        squares = jnp.asarray(sum((one[:, None] - other[None]) ** 2 for one, other in parameters))
        of_best = squares[:, best]
        is_in_cell = of_best <= jnp.min(jnp.where(exists[None], squares, jnp.inf), axis=1)
        is_accepted = is_in_cell | (of_best < self.radius**2)
        chosen = jnp.where(jnp.any(is_accepted), jnp.argmax(is_accepted), jnp.argmin(of_best))

        is_random = jax.random.uniform(key_choice, (), actions.dtype) <= self.probability
        is_random |= jnp.sum(exists) <= 1
        return jnp.where(is_random, space.sample(key_random), candidates[chosen])
