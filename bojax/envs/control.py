"""What the continuous domains share (thesis, Section 5.7.2): one action, a goal, and two ways to be paid."""

import abc
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from bojax.envs.base import Env, Transition
from bojax.envs.spaces import Box


class ControlTask(Env):
    """A deterministic system of one input, which has to be brought to a goal.

    With `reward` `"goal-only"` an episode pays 1 at the goal and -1 at a failure, both absorbing, and 0
    otherwise (p. 106). With `"classic"` it pays what the domain pays in Gym, and each domain says what ends
    it then. A step is a success where it reaches the goal, whatever it pays; where goal and failure meet,
    it is a failure.

    Attributes:
        reward: What is paid.
    """

    reward: eqx.AbstractVar[Literal["goal-only", "classic"]]

    @property
    @abc.abstractmethod
    def observation_space(self) -> Box:
        """See `Env`."""

    @property
    @abc.abstractmethod
    def action_space(self) -> Box:
        """See `Env`."""

    @abc.abstractmethod
    def observe(self, state: Float[Array, "S"]) -> Float[Array, "D"]:
        """See `Env`."""

    @abc.abstractmethod
    def advance(self, state: Float[Array, "S"], action: Float[Array, ""]) -> Float[Array, "S"]:
        """The state one time step later, under an action within its bounds."""

    @abc.abstractmethod
    def is_goal(self, state: Float[Array, "S"]) -> Bool[Array, ""]:
        """Whether the goal is reached in a state."""

    def is_failure(self, state: Float[Array, "S"]) -> Bool[Array, ""]:
        """Whether a state is a failure; most domains know none."""
        return jnp.zeros_like(state[0], bool)

    @abc.abstractmethod
    def classic(
        self,
        state: Float[Array, "S"],
        action: Float[Array, ""],
        success: Bool[Array, ""],
        failure: Bool[Array, ""],
        after: Float[Array, "S"],
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """Classic reward of a step from `state` to `after`, and whether it ends the episode."""

    def step(
        self, key: Key[Array, ""], state: Float[Array, "S"], action: Float[Array, "1"]
    ) -> tuple[Float[Array, "S"], Transition]:
        """See `Env`; nothing is random."""
        del key
        bounds = self.action_space
        clipped = jnp.clip(action.astype(state.dtype), bounds.low, bounds.high)[0]
        after = self.advance(state, clipped)
        failure = self.is_failure(after)
        success = self.is_goal(after) & ~failure
        if self.reward == "goal-only":
            reward = success.astype(state.dtype) - failure.astype(state.dtype)
            terminated = success | failure
        else:
            reward, terminated = self.classic(state, clipped, success, failure, after)
        never = jnp.zeros_like(terminated)
        return after, Transition(self.observe(after), reward, terminated, never, success)


def symmetric(*high: Float[Array, ""]) -> Box:
    """A box around the origin."""
    return Box(-jnp.stack(high), jnp.stack(high))


def wrapped(angle: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """The angle in [-pi, pi) that points in the same direction."""
    return jnp.mod(angle + jnp.pi, 2.0 * jnp.pi) - jnp.pi


def sign(x: Float[Array, ""]) -> Float[Array, ""]:
    """-1 below 0, and 1 from there on: an action that knows two values only."""
    return jnp.where(x < 0.0, -jnp.ones_like(x), jnp.ones_like(x))
