"""How exploration changes over a run (thesis, Section 5.5): any of these stands in a sweep."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.learning.base import Balance


class Schedule(eqx.Module):
    """The balance of every episode."""

    @abc.abstractmethod
    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> Balance:
        """The balance of an episode.

        Args:
            episode: Number of training episodes before it.
            has_reached: Whether the target of the test episodes has been reached (Section 5.5.2).
        """


class Constant(Schedule):
    """Explore and learn alike in every episode."""

    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> Balance:
        """See `Schedule`."""
        del has_reached
        return Balance(jnp.ones((), jnp.result_type(float)), episode >= 0)


class Decay(Schedule):
    """1 / (1 + c t), with t the number of episodes before (p. 121).

    Attributes:
        rate: c.
    """

    rate: Float[Array, ""]

    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> Balance:
        """See `Schedule`."""
        del has_reached
        return Balance(1.0 / (1.0 + self.rate * episode.astype(self.rate.dtype)), episode >= 0)


class Budget(Schedule):
    """Explore for some episodes, then exploit; take exploration up again after some more (p. 119).

    Attributes:
        episodes: Episodes with exploration.
        resume_after: Episodes without, after which it goes on; None for never.
        learns_without: Whether the learner goes on learning while it does not explore.
    """

    episodes: Float[Array, ""]
    resume_after: Float[Array, ""] | None
    learns_without: bool = eqx.field(static=True)

    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> Balance:
        """See `Schedule`."""
        del has_reached
        episode = episode.astype(self.episodes.dtype)
        explores = episode < self.episodes
        if self.resume_after is not None:
            explores = explores | (episode >= self.episodes + self.resume_after)
        return Balance(explores.astype(self.episodes.dtype), explores | self.learns_without)


class UntilTarget(Schedule):
    """Explore until the test episodes reach their target, then exploit (p. 123).

    Attributes:
        learns_after: Whether the learner goes on learning after it.
    """

    learns_after: bool = eqx.field(static=True)

    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> Balance:
        """See `Schedule`."""
        del episode
        return Balance((~has_reached).astype(jnp.result_type(float)), ~has_reached | self.learns_after)


class Exploit(Schedule):
    """Neither explore nor learn: evaluate what is known."""

    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> Balance:
        """See `Schedule`."""
        del has_reached
        return Balance(jnp.zeros((), jnp.result_type(float)), episode < 0)
