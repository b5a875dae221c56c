"""The base of the continuous domains (thesis, Section 5.7.2): a goal, and two reward functions."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.base import Env, EnvState, TimeStep
from bojax.envs.spaces import Box
from bojax.numerics.choices import Choice, one_of

_REWARDS = one_of("goal-only", "classic")


class ControlStep(eqx.Module):
    """A step of a `ControlTask`."""

    state: EnvState  # state before the step
    action: Float[Array, "A"]  # action, within its bounds
    after: EnvState  # state after the step
    success: Bool[Array, ""]  # whether the step reached the goal
    failure: Bool[Array, ""]  # whether the state after the step is a failure


class ControlTask(Env):
    """A system to be controlled to a goal.

    With the `"goal-only"` reward, a step to the goal pays 1 and a step to a failure pays -1; both states are
    terminal, and all other steps pay 0 (p. 106). With the `"classic"` reward, steps pay the reward of the
    domain in Gym, and each domain defines its terminal states. A step to the goal is a success with either
    reward, unless the state is a failure. A step after which the simulation has diverged pays NaN.
    """

    reward: Choice = eqx.field(converter=_REWARDS)

    @abc.abstractmethod
    def advance(self, key: Key[Array, ""], state: EnvState, action: Float[Array, "A"]) -> EnvState:
        """The state one time step later, under an action within its bounds; most domains need no key."""

    @abc.abstractmethod
    def is_goal(self, state: EnvState) -> Bool[Array, ""]:
        """Whether the goal is reached in a state."""

    def is_failure(self, state: EnvState) -> Bool[Array, ""]:
        """Whether a state is a failure; most domains have no failures."""
        return jnp.zeros((), bool)

    def has_diverged(self, state: EnvState) -> Bool[Array, ""]:
        """Whether the simulation has diverged to a state that is not physical; by default it never does."""
        return jnp.zeros((), bool)

    def classic(self, step: ControlStep) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """Classic reward of a step, and whether it ends the episode; by default -1, and the goal ends it."""
        return -jnp.ones_like(step.action[0]), step.success

    @override
    def step(
        self, key: Key[Array, ""], state: EnvState, action: Float[Array, "A"]
    ) -> tuple[EnvState, TimeStep]:
        bounds = self.action_space
        assert isinstance(bounds, Box)
        dtype = bounds.low.dtype
        clipped = jnp.clip(action.astype(dtype), bounds.low, bounds.high)
        after = self.advance(key, state, clipped)
        failure = self.is_failure(after)
        success = self.is_goal(after) & ~failure
        # Both, so that runs with different rewards share a compiled program.
        classic, ends = self.classic(ControlStep(state, clipped, after, success, failure))
        is_classic = _REWARDS(self.reward).is_("classic")  # a class of one's own may declare it as text
        reward = jnp.where(is_classic, classic, success.astype(dtype) - failure.astype(dtype))
        reward = jnp.where(self.has_diverged(after), jnp.nan, reward)
        terminated = jnp.where(is_classic, ends, success | failure)
        never = jnp.zeros_like(terminated)
        return after, TimeStep(self.observe(after), reward, terminated, never, success)


def penalties(
    step: ControlStep, failure_reward: float, dtype: jnp.dtype
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """The classic reward of the author's code in domains with failures, and whether it ends the episode.

    -1 a step, 0 at the goal and `failure_reward` at a failure; both end the episode.
    """
    paid = jnp.where(step.success, 0.0, -1.0).astype(dtype)
    return jnp.where(step.failure, jnp.asarray(failure_reward, dtype), paid), step.success | step.failure


def symmetric(*high: Float[Array, ""]) -> Box:
    """A box around the origin."""
    return Box(-jnp.stack(high), jnp.stack(high))


def sign(x: Float[Array, ""]) -> Float[Array, ""]:
    """-1 for negative numbers, otherwise 1: an action with two values."""
    return jnp.where(x < 0.0, -jnp.ones_like(x), jnp.ones_like(x))
