"""An episode of learning on its way, and its steps: kept as rows of numbers, told as a table."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bojax.envs.base import EnvState, Observation
from bojax.envs.spaces import Box, Space
from bojax.learning.base import Experience, LearnerState
from bojax.results.schema import Column, Table


class Trial(eqx.Module):
    """One episode on its way.

    Attributes:
        env: State of the environment.
        observation: What was seen last.
        learner: What has been learned up to now.
        is_active: The episode goes on.
        total: Sum of the rewards so far.
        length: Steps made.
        terminated: It ended in an absorbing state.
        truncated: It was cut off.
        success: The goal was reached.
        failed: The environment returned a number that is none.
        outside: Steps that led to an observation outside the declared bounds.
        steps: Every step, a row of numbers for each (see `StepRows`); T is 0 in a test.
    """

    env: EnvState
    observation: Observation
    learner: LearnerState
    is_active: Bool[Array, ""]
    total: Float[Array, ""]
    length: Int[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]
    success: Bool[Array, ""]
    failed: Bool[Array, ""]
    outside: Int[Array, ""]
    steps: Float[Array, "T R"]


class StepRows(eqx.Module):
    """Steps as rows of numbers: one write a step, where an array for each part would be six.

    Attributes:
        observations: Space of observations.
        actions: Space of actions.
        frame_size: Numbers that an animation needs of a state, see `Env.frame`; 0 for none.
        dtype: Precision of the rows; whole numbers below 2^24 stay exact.
    """

    observations: Space
    actions: Space
    frame_size: int = eqx.field(static=True)
    dtype: jnp.dtype = eqx.field(static=True)

    @property
    def width(self) -> int:
        """Numbers of a row, R."""
        return 2 * self.observations.num_dims + self.actions.num_dims + 3 + self.frame_size

    def pack(
        self, step: Experience, expected: Float[Array, ""], frame: Float[Array, "Q"] | None
    ) -> Float[Array, "R"]:
        """A step, what was expected of it, and the frame of the state in which it was taken."""
        parts = [step.observation, step.action, step.next_observation, step.reward, step.terminated, expected]
        parts += [] if frame is None else [frame]
        return jnp.concatenate([jnp.ravel(part).astype(self.dtype) for part in parts])

    def unpack(self, rows: Float[Array, "T R"]) -> tuple[Experience, Float[Array, "T"], Float[Array, "T Q"]]:
        """The steps, what was expected of them, and their frames."""
        spaces = self.observations, self.actions, self.observations
        ends = np.cumsum([space.num_dims for space in spaces]).tolist()
        *vectors, rest = jnp.split(rows, ends, axis=1)
        observation, action, after = (
            part if isinstance(space, Box) else part[:, 0].astype(jnp.int32)
            for part, space in zip(vectors, spaces, strict=True)
        )
        return Experience(observation, action, rest[:, 0], after, rest[:, 1] > 0.5), rest[:, 2], rest[:, 3:]

    def table(
        self, rows: Float[Array, "T R"], length: Int[Array, ""], episode: Int[Array, ""]
    ) -> dict[str, Array]:
        """The rows of `steps.parquet` of an episode."""
        steps, expected, frames = self.unpack(rows)
        number = jnp.arange(len(expected), dtype=jnp.int32) + 1
        columns = {
            "episode": jnp.broadcast_to(episode, number.shape),
            "step": number,
            "reward": steps.reward,
            "planned_reward": expected,
            "accumulated_reward": jnp.cumsum(steps.reward),
            "done": number == length,
            "valid": number <= length,
        }
        vectors = {"observation": steps.observation, "action": steps.action, "qpos": frames}
        for name, values in vectors.items():
            flat = values.reshape(len(number), -1).astype(self.dtype)
            columns |= {f"{name}_{i}": flat[:, i] for i in range(flat.shape[1])}
        return columns

    @property
    def columns(self) -> Table:
        """What `table` holds."""
        sizes = {
            "observation": self.observations.num_dims,
            "action": self.actions.num_dims,
            "qpos": self.frame_size,
        }
        return _STEP_COLUMNS + tuple(
            Column(f"{name}_{i}", "float32", "", f"{name}, component {i}, in which the step was taken")
            for name, size in sizes.items()
            for i in range(size)
        )


_SLACK = 1e-4
"""How far beyond its bounds an observation counts as outside, in units of their range: more than rounding."""


def is_outside(space: Space, observation: Observation) -> Bool[Array, ""]:
    """Whether an observation lies outside its declared bounds."""
    if not isinstance(space, Box):
        return (observation < 0) | (observation >= space.num)
    unit = space.to_unit(observation)
    return jnp.any((unit < -_SLACK) | (unit > 1.0 + _SLACK))


_STEP_COLUMNS: Table = (
    Column("episode", "int32", "", "number of the training episode, from 1"),
    Column("step", "int32", "", "number of the step in it, from 1"),
    Column("reward", "float64", "", "reward"),
    Column("planned_reward", "float64", "", "return Q that the learner expected of the action"),
    Column("accumulated_reward", "float64", "", "sum of the episode's rewards so far"),
    Column("done", "bool", "", "the episode ended with this step"),
)
