"""The interface of a learner, one method for each line of Algorithm 5 of the thesis."""

import abc
from typing import Any, ClassVar, TypeAlias

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int, Key, Scalar

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Space
from bojax.numerics.lanes import LANES_ON_GPU
from bojax.numerics.trial import check_names
from bojax.results.schema import Table

LearnerState: TypeAlias = Any
"""Everything a learner has learned: a tree of strongly typed arrays."""


class ExplorationState(eqx.Module):
    """How much a learner explores in an episode, and whether it learns; computed by a `Schedule`.

    A test episode has scale 0 and does not learn.

    Attributes:
        scale: Factor of the learner's exploration weight (kappa, xi or epsilon); 0 is pure exploitation.
        is_learning: Whether the learner may change. Where it is false, `observe` and `end_episode` return
            the state they were given.
    """

    scale: Float[Array, ""]
    is_learning: Bool[Array, ""]


class Transition(eqx.Module):
    """One transition (s, a, r, s'), or several, `[N, ...]`.

    Attributes:
        observation: Observation of the state s.
        action: Action a.
        reward: Reward r.
        next_observation: Observation of the next state s'.
        terminated: Whether s' is terminal. A time limit truncates an episode; it is not terminal.
    """

    observation: Observation
    action: Action
    reward: Float[Array, "*N"]
    next_observation: Observation
    terminated: Bool[Array, "*N"]


class Episode(eqx.Module):
    """All transitions of an episode, padded to T rows.

    Attributes:
        transitions: The transitions in order, `[T, ...]`.
        length: Number of steps; rows from there on are padding.
    """

    transitions: Transition
    length: Int[Array, ""]


_OVERRIDABLE = (
    "check_spaces",
    "init",
    "act",
    "observe",
    "flush",
    "end_episode",
    "learns_from_episodes",
    "values",
)
"""Methods that a subclass defines or overrides; of others, it keeps the parameters."""


class Learner(eqx.Module):
    """A learning algorithm, written for a single run. All methods are pure; the caller keeps the state.

    Attributes:
        block: Number of steps between two calls of `flush`.
        lanes_on_cpu: Largest number of lanes per CPU device at which a batch is still fast.
        narrowest: Least number of lanes of a GPU to which the last runs of a chunk move. With fewer, an
            episode hardly takes less time, and each number of lanes is a program to compile.
    """

    lanes_on_cpu: ClassVar[int] = 64
    # An episode of EMU-Q on an H200 has a fixed cost, as large as the cost of about 100 lanes.
    narrowest: ClassVar[int] = 32

    block: eqx.AbstractVar[int]

    def __init_subclass__(cls, **kwargs):
        """Check the names of a user's class, or raise TypeError."""
        super().__init_subclass__(**kwargs)
        check_names(cls, Learner, _OVERRIDABLE)

    @property
    def lanes_on_gpu(self) -> int:
        """Default number of lanes of a GPU, whose memory limits it."""
        return LANES_ON_GPU

    @property
    @abc.abstractmethod
    def exploration_weight(self) -> Float[Array, ""]:
        """Weight of exploration at scale 1: kappa, xi or epsilon."""

    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        """Refuse an environment that the learner cannot be used for; by default none is refused.

        Raises:
            ValueError: The observations or actions are of a kind that the learner does not take.
        """

    def fitted(self, observation_space: Space, action_space: Space) -> "Learner":
        """The learner with values of the settings that are left to these spaces; by default itself."""
        return self

    @abc.abstractmethod
    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> LearnerState:
        """The state of a learner that has observed nothing, and will observe up to `capacity` transitions."""

    @abc.abstractmethod
    def act(
        self,
        key: Key[Array, ""],
        state: LearnerState,
        observation: Observation,
        exploration: ExplorationState,
    ) -> tuple[Action, Float[Array, ""]]:
        """The action to take, and the return Q that the learner expects of it."""

    def observe(
        self,
        key: Key[Array, ""],
        state: LearnerState,
        transition: Transition,
        exploration: ExplorationState,
        step_in_block: Int[Array, ""],
    ) -> LearnerState:
        """Learn from one transition; by default nothing is learned.

        `step_in_block` is the number of steps since the last `flush`, the same in every lane of a batch.
        """
        return state

    def flush(self, state: LearnerState) -> LearnerState:
        """Apply delayed updates; called after every `block` steps and at the end of an episode."""
        return state

    def end_episode(
        self, key: Key[Array, ""], state: LearnerState, episode: Episode, exploration: ExplorationState
    ) -> LearnerState:
        """Learn from a whole episode, after its last transition has been observed."""
        return state

    @property
    def learns_from_episodes(self) -> bool:
        """Whether `end_episode` learns from the transitions of an episode; by default, if it is overridden.

        If not, each lane of a batch may begin its next episode while others are still in the last one, and
        `end_episode` gets no transitions.
        """
        return type(self).end_episode is not Learner.end_episode

    def policy_state(self, state: LearnerState) -> LearnerState:
        """The part of the state that is exported. It suffices to act, but not to continue learning.

        Its arrays have the shapes that `init` gives them at a capacity of 0.
        """
        return state

    @property
    def columns(self) -> Table:
        """Columns of `runs.parquet` that `summary` adds to those of all learners; none by default."""
        return ()

    def summary(self, state: LearnerState) -> dict[str, Scalar]:
        """Scalar results of a run in the columns of `columns`."""
        return {}

    @abc.abstractmethod
    def values(
        self, state: LearnerState, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Q and U of one state-action pair; U is 0 for learners without exploration values."""
