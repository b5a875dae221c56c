"""Schedules: how exploration and learning change over the episodes of a run (thesis, Section 5.5)."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from bojax.learning.base import ExplorationState


class Schedule(eqx.Module):
    """The exploration state of every training episode."""

    @abc.abstractmethod
    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> ExplorationState:
        """The exploration state after `episode` training episodes.

        `has_reached` is whether the test episodes have reached their target return (Section 5.5.2).
        """


class Constant(Schedule):
    """Explore and learn at full scale in every episode.

    Settings: `bojax.learning.settings.Constant`.
    """

    @override
    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> ExplorationState:
        return ExplorationState(jnp.ones((), jnp.result_type(float)), episode >= 0)


class Decay(Schedule):
    """Scale 1 / (1 + c t), with t the number of previous training episodes (p. 121).

    Settings: `bojax.learning.settings.Decay`.
    """

    rate: Float[Array, ""]

    @override
    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> ExplorationState:
        return ExplorationState(1.0 / (1.0 + self.rate * episode.astype(self.rate.dtype)), episode >= 0)


class Linear(Schedule):
    """Scale that falls linearly from 1 to `final` over a number of episodes, then stays there.

    Beyond the thesis: the schedule of epsilon in deep Q-networks (Mnih et al., Nature 518, 2015), by episode.

    Settings: `bojax.learning.settings.Linear`.
    """

    episodes: Float[Array, ""]
    final: Float[Array, ""]

    @override
    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> ExplorationState:
        share = jnp.minimum(episode.astype(self.episodes.dtype) / self.episodes, 1.0)
        return ExplorationState(1.0 + share * (self.final - 1.0), episode >= 0)


class Budget(Schedule):
    """Explore for a number of episodes, then exploit; optionally resume exploration later (p. 119).

    Settings: `bojax.learning.settings.Budget`.
    """

    episodes: Float[Array, ""]
    resume_after: Float[Array, ""] | None
    learns_without: Bool[Array, ""]

    @override
    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> ExplorationState:
        episode = episode.astype(self.episodes.dtype)
        explores = episode < self.episodes
        if self.resume_after is not None:
            explores = explores | (episode >= self.episodes + self.resume_after)
        return ExplorationState(explores.astype(self.episodes.dtype), explores | self.learns_without)


class UntilTarget(Schedule):
    """Explore until the test episodes reach their target return, then exploit (p. 123).

    Settings: `bojax.learning.settings.UntilTarget`.
    """

    learns_after: Bool[Array, ""]

    @override
    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> ExplorationState:
        return ExplorationState(
            (~has_reached).astype(jnp.result_type(float)), ~has_reached | self.learns_after
        )


class Exploit(Schedule):
    """Neither explore nor learn: evaluate a saved learner.

    Settings: `bojax.learning.settings.Exploit`.
    """

    @override
    def __call__(self, episode: Int[Array, ""], has_reached: Bool[Array, ""]) -> ExplorationState:
        return ExplorationState(jnp.zeros((), jnp.result_type(float)), episode < 0)
