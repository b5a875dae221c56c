"""The state of an episode of learning, and its change by a step of the environment."""

from dataclasses import replace
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.envs.base import Action, Env, EnvState, Observation, TimeStep
from bojax.envs.spaces import Box, Space
from bojax.learning.base import LearnerState

T = TypeVar("T")  # A tree of arrays


class Choice(NamedTuple):
    """An action, and the return Q that the learner expects of it."""

    action: Action
    expected: Float[Array, ""]


class EpisodeState(eqx.Module):
    """The state of an episode."""

    env: EnvState  # state of the environment; None if it steps on the host
    observation: Observation  # last observation
    learner: LearnerState  # state of the learner
    is_active: Bool[Array, ""]  # whether the episode has not ended
    total: Float[Array, ""]  # sum of the rewards so far
    length: Int[Array, ""]  # number of steps so far
    terminated: Bool[Array, ""]  # whether the episode ended in a terminal state
    truncated: Bool[Array, ""]  # whether the episode was truncated
    success: Bool[Array, ""]  # whether the goal was reached
    failed: Bool[Array, ""]  # whether the environment returned a non-finite value
    outside: Int[Array, ""]  # number of steps to an observation outside the declared bounds
    rows: Float[Array, "T R"]  # the steps so far, see `StepRows`; T is 0 in a test
    # The last choice of the learner, where it is repeated for several steps; None if the learner chooses in
    # every step
    repeated: Choice | None


def apply_transition(
    env: Env, episode: EpisodeState, env_state: EnvState, time_step: TimeStep
) -> tuple[EpisodeState, Bool[Array, ""]]:
    """The episode after a step, and whether the step counts.

    A step counts if the episode was active and all values are finite; a non-finite value ends the episode as
    failed. The learner and the rows of the episode stay the same.
    """
    # Everything is computed in every lane and kept where the step counts; leaves that a step leaves alone are
    # passed on as they are. A non-finite value ends the episode with a total of NaN, and never reaches
    # learner or state.
    dtype = episode.total.dtype
    is_finite = jnp.isfinite(time_step.reward) & jnp.all(jnp.isfinite(time_step.observation.astype(dtype)))
    counts = episode.is_active & is_finite
    fails = episode.is_active & ~is_finite
    length = episode.length + counts.astype(jnp.int32)
    terminated = counts & time_step.terminated
    truncated = counts & ~time_step.terminated & (time_step.truncated | (length >= env.max_steps))
    is_outside = outside_bounds(env.observation_space, time_step.observation)

    after = replace(
        episode,
        env=where(counts, env_state, episode.env),
        observation=where(counts, time_step.observation, episode.observation),
        is_active=counts & ~terminated & ~truncated,
        total=episode.total + jnp.where(counts, time_step.reward, jnp.where(fails, jnp.nan, 0.0)),
        length=length,
        terminated=episode.terminated | terminated,
        truncated=episode.truncated | truncated,
        success=episode.success | (counts & time_step.success),
        failed=episode.failed | fails,
        outside=episode.outside + (counts & is_outside).astype(jnp.int32),
    )
    return after, counts


def where(condition: Bool[Array, ""], new: T, old: T) -> T:
    """The new tree where a condition holds, else the old one; what is not new is passed on as it is."""
    # A select of it would use a key twice.
    return jax.tree.map(lambda n, o: o if n is o else jnp.where(condition, n, o), new, old)


_TOLERANCE = 1e-4  # rounding error that an observation may exceed its bounds by, in units of their range


def outside_bounds(space: Space, observation: Observation) -> Bool[Array, ""]:
    """Whether an observation is outside its declared bounds."""
    if not isinstance(space, Box):
        return (observation < 0) | (observation >= space.num)
    unit = space.to_unit(observation)
    return jnp.any((unit < -_TOLERANCE) | (unit > 1.0 + _TOLERANCE))
