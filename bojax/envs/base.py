"""The protocol of an environment: what a learner acts in."""

import abc
from typing import Any, ClassVar, TypeAlias

import equinox as eqx
from jaxtyping import Array, Bool, Float, Key

from bojax.envs.spaces import Space

EnvState: TypeAlias = Any
"""The true state of an environment: a tree of arrays."""

Observation: TypeAlias = Array
"""What a learner sees of it: `[D]` numbers of a `Box`, or one `int32` of a `Discrete` space."""

Action: TypeAlias = Array
"""The same of an action."""


class TimeStep(eqx.Module):
    """What `Env.step` returns of the step, or of several, `[N, ...]`.

    Attributes:
        observation: Observation of the state that follows.
        reward: Reward of the step.
        terminated: That state is absorbing: nothing comes after it.
        truncated: The environment ends the episode there although the state is not absorbing. The limit of
            `Env.max_steps` is not among it: that is the experiment's to keep.
        success: The goal was reached with this step.
    """

    observation: Observation
    reward: Float[Array, "*N"]
    terminated: Bool[Array, "*N"]
    truncated: Bool[Array, "*N"]
    success: Bool[Array, "*N"]


class Env(eqx.Module):
    """An environment, written for one lane; it holds no state, and whoever steps it owns the resets.

    Attributes:
        max_steps: Steps after which an episode is cut off; a time limit, no absorbing state.
        is_hosted: Whether it steps on the host, one object for each lane, and cannot be compiled.
    """

    is_hosted: ClassVar[bool] = False

    max_steps: eqx.AbstractVar[int]

    @property
    @abc.abstractmethod
    def observation_space(self) -> Space:
        """Declared bounds of observations; learners scale by them, and values outside are kept."""

    @property
    @abc.abstractmethod
    def action_space(self) -> Space:
        """Bounds of actions; an action outside is clipped by the environment."""

    def of_run(self, key: Key[Array, ""]) -> "Env":
        """The environment whose `reset` begins the episodes of one run, which may share what is drawn here.

        Only states carry that on: everything but `reset` is asked of the environment as it was built.
        """
        del key
        return self

    @abc.abstractmethod
    def reset(self, key: Key[Array, ""]) -> EnvState:
        """A state to start from."""

    @abc.abstractmethod
    def observe(self, state: EnvState) -> Observation:
        """What is seen of a state."""

    def frame(self, state: EnvState) -> Float[Array, "Q"] | None:
        """What an animation needs of a state, where observations do not tell it; recorded with the steps."""
        del state
        return None

    @abc.abstractmethod
    def step(self, key: Key[Array, ""], state: EnvState, action: Action) -> tuple[EnvState, TimeStep]:
        """The state that an action leads to, and what that means."""
