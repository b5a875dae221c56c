"""The steps of an episode as rows of numbers, and their columns in `steps.parquet`."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bojax.envs.base import Env
from bojax.envs.spaces import Box, Space
from bojax.learning.base import Transition
from bojax.results.schema import Column, Table


class StepRows(eqx.Module):
    """A layout of transitions as rows of numbers, so that a step is one write instead of six."""

    observations: Space  # space of observations
    actions: Space  # space of actions
    frame_size: int = eqx.field(static=True)  # size of `Env.frame`; 0 without one
    dtype: jnp.dtype = eqx.field(static=True)  # precision of the rows; integers below 2^24 are exact

    @classmethod
    def of(cls, env: Env, dtype: jnp.dtype) -> "StepRows":
        """The layout for the transitions of an environment."""
        frame_size = 0 if env.is_hosted else env.frame_size
        return cls(env.observation_space, env.action_space, frame_size, dtype)

    @property
    def width(self) -> int:
        """Size of a row, R."""
        return 2 * self.observations.num_dims + self.actions.num_dims + 4 + self.frame_size

    def pack(
        self,
        transition: Transition,
        expected: Float[Array, ""],
        total: Float[Array, ""],
        frame: Float[Array, "Q"] | None,
    ) -> Float[Array, "R"]:
        """Pack a transition, the return expected of its action, all rewards so far, and the frame."""
        parts = [
            transition.observation,
            transition.action,
            transition.next_observation,
            transition.reward,
            transition.terminated,
            expected,
            total,
        ]
        parts += [] if frame is None else [frame]
        return jnp.concatenate([jnp.ravel(part).astype(self.dtype) for part in parts])

    def unpack(self, rows: Float[Array, "T R"]) -> tuple[Transition, Float[Array, "T"]]:
        """The transitions, and the returns expected of their actions."""
        transitions, expected, _, _ = self._unpacked(rows)
        return transitions, expected

    def _unpacked(
        self, rows: Float[Array, "T R"]
    ) -> tuple[Transition, Float[Array, "T"], Float[Array, "T"], Float[Array, "T Q"]]:
        spaces = self.observations, self.actions, self.observations
        ends = np.cumsum([space.num_dims for space in spaces]).tolist()
        *vectors, rest = jnp.split(rows, ends, axis=1)
        observation, action, after = (
            part if isinstance(space, Box) else part[:, 0].astype(jnp.int32)
            for part, space in zip(vectors, spaces, strict=True)
        )
        transitions = Transition(observation, action, rest[:, 0], after, rest[:, 1] > 0.5)
        return transitions, rest[:, 2], rest[:, 3], rest[:, 4:]

    def table(
        self, rows: Float[Array, "T R"], lengths: Int[Array, "E"], episodes: Int[Array, "E"]
    ) -> dict[str, Array]:
        """The rows of successive episodes in `steps.parquet`.

        The steps of all episodes come one episode after the other; `lengths` are their numbers of steps, and
        `episodes` their numbers in the run.
        """
        transitions, expected, totals, frames = self._unpacked(rows)
        index, ends = jnp.arange(len(expected), dtype=jnp.int32), jnp.cumsum(lengths)
        # The last episode has all rows after the others, of which those beyond its end are not valid.
        own = jnp.sum(index[:, None] >= ends[None, :-1], axis=1, dtype=jnp.int32)
        number = index - (ends - lengths)[own] + 1
        columns = {
            "episode": episodes[own],
            "step": number,
            "reward": transitions.reward,
            "planned_reward": expected,
            "accumulated_reward": totals,
            "done": number == lengths[own],
            "valid": number <= lengths[own],
        }
        vectors = {"observation": transitions.observation, "action": transitions.action, "qpos": frames}
        for name, values in vectors.items():
            flat = values.reshape(len(number), -1).astype(self.dtype)
            columns |= {f"{name}_{i}": flat[:, i] for i in range(flat.shape[1])}
        return columns

    @property
    def columns(self) -> Table:
        """The columns of `table`."""
        sizes = {
            "observation": self.observations.num_dims,
            "action": self.actions.num_dims,
            "qpos": self.frame_size,
        }
        when = {"observation": " before the step", "action": "", "qpos": " before the step"}
        return _STEP_COLUMNS + tuple(
            Column(f"{name}_{i}", "float32", "", f"component {i} of {name}{when[name]}")
            for name, size in sizes.items()
            for i in range(size)
        )


_STEP_COLUMNS: Table = (
    Column("episode", "int32", "", "number of the training episode, from 1"),
    Column("step", "int32", "", "number of the step in it, from 1"),
    Column("reward", "float64", "", "reward"),
    Column("planned_reward", "float64", "", "return Q that the learner expected of the action"),
    Column("accumulated_reward", "float64", "", "sum of the episode's rewards so far"),
    Column("done", "bool", "", "the episode ended with this step"),
)
