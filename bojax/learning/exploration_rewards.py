"""Exploration rewards r_e of tabular learners (thesis, Section 5.4.3)."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override


class ExplorationReward(eqx.Module):
    """An exploration reward from visit counts; at most 0, so that initial values of 0 are optimistic."""

    @abc.abstractmethod
    def __call__(self, count: Float[Array, ""], next_counts: Float[Array, "A"]) -> Float[Array, ""]:
        """The exploration reward r_e, from earlier visits of the pair and of every next action."""


class FirstVisit(ExplorationReward):
    """0 for the first visit of a state-action pair, -1 for later visits (p. 118).

    Settings: `bojax.learning.settings.FirstVisit`.
    """

    @override
    def __call__(self, count: Float[Array, ""], next_counts: Float[Array, "A"]) -> Float[Array, ""]:
        return -(count > 0).astype(count.dtype)


class NextUncertainty(ExplorationReward):
    """Mean uncertainty of the next state's actions, E_a'[sigma(s', a')] - 1: (5.9) with a uniform a'.

    The uncertainty of a pair visited n times is sigma = 1 / sqrt(1 + n). Its maximum, 1, is subtracted so
    that the reward is at most 0. A terminal state has no visits and keeps the maximum.

    Settings: `bojax.learning.settings.NextUncertainty`.
    """

    @override
    def __call__(self, count: Float[Array, ""], next_counts: Float[Array, "A"]) -> Float[Array, ""]:
        return jnp.mean(jax.lax.rsqrt(1.0 + next_counts)) - 1.0
