"""Exploration rewards of tabular learners (thesis, Section 5.4.3): what r_e a transition is worth."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class ExplorationReward(eqx.Module):
    """An exploration reward from counts of visits; at most 0, so that values begin optimistic at 0."""

    @abc.abstractmethod
    def __call__(self, count: Float[Array, ""], next_counts: Float[Array, "A"]) -> Float[Array, ""]:
        """The reward r_e of a transition.

        Args:
            count: Visits of the state and action before this one.
            next_counts: Visits of each action in the state that follows, before this transition.
        """


class FirstVisit(ExplorationReward):
    """0 for the first visit of a state and action, -1 for any other (p. 118)."""

    def __call__(self, count: Float[Array, ""], next_counts: Float[Array, "A"]) -> Float[Array, ""]:
        """See `ExplorationReward`."""
        del next_counts
        return -(count > 0).astype(count.dtype)


class NextUncertainty(ExplorationReward):
    """What there is left to explore in the next state: E_a'[sigma(s', a')] - 1, (5.9) with a uniform a'.

    The uncertainty is sigma = 1 / sqrt(1 + n), n the visits of the pair; 1 is its greatest value, and is
    taken off to keep the reward at most 0. Nothing is ever done in an absorbing state: it stays uncertain.
    """

    def __call__(self, count: Float[Array, ""], next_counts: Float[Array, "A"]) -> Float[Array, ""]:
        """See `ExplorationReward`."""
        del count
        return jnp.mean(jax.lax.rsqrt(1.0 + next_counts)) - 1.0
