"""The protocol of a learner: Algorithm 5 of the thesis, one method a line."""

import abc
from typing import Any, TypeAlias

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Space

LearnerState: TypeAlias = Any
"""What a learner has learned: a tree of strongly typed arrays."""


class Balance(eqx.Module):
    """How a learner is to behave now; schedules make it, and a test episode is `Balance` 0, not learning.

    Attributes:
        exploration: Factor of the learner's weight of exploration (kappa, xi or epsilon); 0 exploits.
        is_learning: Whether the learner changes; where it is false, `observe` and `end_episode` leave every
            number of its state as it is.
    """

    exploration: Float[Array, ""]
    is_learning: Bool[Array, ""]


class Experience(eqx.Module):
    """One step, as the learner sees it; or several, `[N, ...]`.

    Attributes:
        observation: What it saw.
        action: What it did.
        reward: What it got.
        next_observation: What it saw then.
        terminated: That state is absorbing; a time limit is not.
    """

    observation: Observation
    action: Action
    reward: Float[Array, "*N"]
    next_observation: Observation
    terminated: Bool[Array, "*N"]


class Episode(eqx.Module):
    """All steps of an episode, `[T, ...]`.

    Attributes:
        steps: The steps, in order.
        length: Number of steps made; rows from there on mean nothing.
    """

    steps: Experience
    length: Int[Array, ""]


class Learner(eqx.Module):
    """A way to learn, written for one lane. All methods are pure; the state is the caller's to keep.

    Attributes:
        block: Number of steps between two calls of `consolidate`.
    """

    block: eqx.AbstractVar[int]

    @property
    @abc.abstractmethod
    def exploration_weight(self) -> Float[Array, ""]:
        """Weight of exploration at a balance of 1: kappa, xi or epsilon."""

    @abc.abstractmethod
    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> LearnerState:
        """A learner that has seen nothing.

        Args:
            key: Randomness.
            observation_space: Space of observations.
            action_space: Space of actions.
            capacity: Most steps that it will ever observe.
        """

    @abc.abstractmethod
    def act(
        self, key: Key[Array, ""], state: LearnerState, observation: Observation, balance: Balance
    ) -> tuple[Action, Float[Array, ""]]:
        """An action, and the return Q that is expected of it."""

    @abc.abstractmethod
    def observe(
        self,
        key: Key[Array, ""],
        state: LearnerState,
        experience: Experience,
        balance: Balance,
        slot: Int[Array, ""],
    ) -> LearnerState:
        """Learn from one step; `slot` counts the steps since `consolidate`, the same in every lane."""

    def consolidate(self, state: LearnerState) -> LearnerState:
        """Called after every `block` steps, and at the end of an episode."""
        return state

    def end_episode(
        self, key: Key[Array, ""], state: LearnerState, episode: Episode, balance: Balance
    ) -> LearnerState:
        """Learn from a whole episode, after the last of its steps has been observed."""
        del key, episode, balance
        return state

    def without_memory(self, state: LearnerState) -> LearnerState:
        """The state as `init` makes it at a capacity of 0: enough to act, not to learn on."""
        return state

    @property
    def lanes_on_cpu(self) -> int:
        """Most lanes per device of a CPU that are fast."""
        return 64

    @abc.abstractmethod
    def values(
        self, state: LearnerState, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Q and U of one pair; U is 0 where a learner has none."""
