"""The interface of an environment."""

import abc
from typing import Any, ClassVar, TypeAlias

import equinox as eqx
import jax
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.adapter import Adapter
from bojax.envs.spaces import Space
from bojax.numerics.trial import check_names
from bojax.results.schema import Table

EnvState: TypeAlias = Any
"""The true state of an environment: a tree of arrays."""

Observation: TypeAlias = Array
"""An observation of the state: `[D]` numbers of a `Box`, or one `int32` of a `Discrete` space."""

Action: TypeAlias = Array
"""An action: `[D]` numbers of a `Box`, or one `int32` of a `Discrete` space."""


class TimeStep(eqx.Module):
    """The result of a step, or of several, `[N, ...]`.

    Attributes:
        observation: Observation of the next state.
        reward: Reward of the step.
        terminated: Whether the next state is terminal.
        truncated: Whether the environment ends the episode in a state that is not terminal. The experiment,
            not the environment, applies the time limit `Env.max_steps`.
        success: Whether the step reached the goal.
    """

    observation: Observation
    reward: Float[Array, "*N"]
    terminated: Bool[Array, "*N"]
    truncated: Bool[Array, "*N"]
    success: Bool[Array, "*N"]


class Env(eqx.Module):
    """An environment, written for one lane. It holds no state; the caller keeps the state and calls `reset`.

    Attributes:
        max_steps: Time limit: number of steps after which an episode is truncated.
        is_hosted: Whether the environment steps on the host, one object for each lane, and is not compiled.
        count_columns: Columns of `runs.parquet` for `counts`.
    """

    is_hosted: ClassVar[bool] = False
    count_columns: ClassVar[Table] = ()

    max_steps: eqx.AbstractVar[int]

    def __init_subclass__(cls, **kwargs):
        """Check the names of a user's class, or raise TypeError."""
        super().__init_subclass__(**kwargs)
        check_names(cls, Env, ("observation_space", "action_space", "reset", "step", "observe"))

    @property
    @abc.abstractmethod
    def observation_space(self) -> Space:
        """Declared bounds of observations, which learners scale by; observations may lie outside them."""

    @property
    @abc.abstractmethod
    def action_space(self) -> Space:
        """Bounds of actions; the environment clips actions to them."""

    def of_run(self, key: Key[Array, ""]) -> "Env":
        """The environment of one run, with random properties that all episodes of the run share.

        Properties that have been drawn stay as they are. A learning run calls only `reset` on the returned
        environment, so the state must contain these properties.
        """
        return self

    def adapter(self) -> Adapter:
        """The conversion of single observations and actions from and to those that users of it have."""
        return Adapter(self.observation_space, self.action_space)

    @abc.abstractmethod
    def reset(self, key: Key[Array, ""]) -> EnvState:
        """An initial state."""

    def observe(self, state: EnvState) -> Observation:
        """The observation of a state; by default the state itself."""
        return state

    def frame(self, state: EnvState) -> Float[Array, "Q"] | None:
        """Numbers of a state that an animation needs besides observations; recorded with the steps."""
        return None

    @property
    def frame_size(self) -> int:
        """Size of `frame`; 0 without one. By default it is traced, with `reset`, if there is one."""
        if type(self).frame is Env.frame:
            return 0
        frame = eqx.filter_eval_shape(_first_frame, self, jax.eval_shape(jax.random.key, 0))
        return 0 if frame is None else frame.size

    def counts(self, state: EnvState) -> dict[str, Int[Array, ""]]:
        """Numbers of events since `reset`, by column of `count_columns`; summed over training."""
        return {}

    @abc.abstractmethod
    def step(self, key: Key[Array, ""], state: EnvState, action: Action) -> tuple[EnvState, TimeStep]:
        """The next state after an action, and the result of the step."""


@eqx.filter_jit  # traced once for all environments of one structure
def _first_frame(env: Env, key: Key[Array, ""]) -> Float[Array, "Q"] | None:
    """The frame of an initial state."""
    return env.frame(env.reset(key))
