"""What the continuous domains share (thesis, Section 5.7.2): a goal, and two ways to be paid."""

import abc
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.base import Env, EnvState, TimeStep
from bojax.envs.spaces import Box


class ControlTask(Env):
    """A system that has to be brought to a goal.

    With `reward` `"goal-only"` an episode pays 1 at the goal and -1 at a failure, both absorbing, and 0
    otherwise (p. 106). With `"classic"` it pays what the domain pays in Gym, and each domain says what ends
    it then. A step is a success where it reaches the goal, whatever it pays; where goal and failure meet,
    it is a failure. A step to a state that no body can be in (`has_diverged`) pays NaN.
    """

    reward: eqx.AbstractVar[Literal["goal-only", "classic"]]

    @property
    @abc.abstractmethod
    @override
    def observation_space(self) -> Box: ...

    @property
    @abc.abstractmethod
    @override
    def action_space(self) -> Box: ...

    @abc.abstractmethod
    @override
    def observe(self, state: EnvState) -> Float[Array, "D"]: ...

    @abc.abstractmethod
    def advance(self, key: Key[Array, ""], state: EnvState, action: Float[Array, "A"]) -> EnvState:
        """The state one time step later, under an action within its bounds; most domains need no key."""

    @abc.abstractmethod
    def is_goal(self, state: EnvState) -> Bool[Array, ""]:
        """Whether the goal is reached in a state."""

    def is_failure(self, state: EnvState) -> Bool[Array, ""]:
        """Whether a state is a failure; most domains know none."""
        del state
        return jnp.zeros((), bool)

    def has_diverged(self, state: EnvState) -> Bool[Array, ""]:
        """Whether the simulation has left what is physical; closed equations do not."""
        del state
        return jnp.zeros((), bool)

    @abc.abstractmethod
    def classic(
        self,
        state: EnvState,
        action: Float[Array, "A"],
        success: Bool[Array, ""],
        failure: Bool[Array, ""],
        after: EnvState,
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """Classic reward of a step from `state` to `after`, and whether it ends the episode."""

    @override
    def step(
        self, key: Key[Array, ""], state: EnvState, action: Float[Array, "A"]
    ) -> tuple[EnvState, TimeStep]:
        bounds = self.action_space
        dtype = bounds.low.dtype
        clipped = jnp.clip(action.astype(dtype), bounds.low, bounds.high)
        after = self.advance(key, state, clipped)
        failure = self.is_failure(after)
        success = self.is_goal(after) & ~failure
        if self.reward == "goal-only":
            reward = success.astype(dtype) - failure.astype(dtype)
            terminated = success | failure
        else:
            reward, terminated = self.classic(state, clipped, success, failure, after)
        reward = jnp.where(self.has_diverged(after), jnp.nan, reward)
        never = jnp.zeros_like(terminated)
        return after, TimeStep(self.observe(after), reward, terminated, never, success)


def symmetric(*high: Float[Array, ""]) -> Box:
    """A box around the origin."""
    return Box(-jnp.stack(high), jnp.stack(high))


def sign(x: Float[Array, ""]) -> Float[Array, ""]:
    """-1 below 0, and 1 from there on: an action that knows two values only."""
    return jnp.where(x < 0.0, -jnp.ones_like(x), jnp.ones_like(x))
