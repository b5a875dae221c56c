"""Cliff walking (Sutton & Barto, Example 6.6), goal-only as in Section 5.5 of the thesis, p. 119."""

from typing import ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.envs.base import TimeStep
from bojax.envs.spaces import Discrete
from bojax.envs.tabular import TabularEnv, moved_to

ROWS, COLUMNS = 4, 12
START, GOAL = 36, 47

ROW_STEPS = (-1, 0, 1, 0)
COLUMN_STEPS = (0, 1, 0, -1)


class CliffWalking(TabularEnv):
    """Walk along a cliff from the lower left to the lower right corner of a 4 x 12 grid.

    States are numbered row by row from the upper left, actions are up, right, down, left, both as in
    Gymnasium's `CliffWalking-v1`. The cells between start and goal are the cliff: an agent that falls returns
    to the start, and the episode continues. A step off the grid leaves the agent where it is.

    Settings: `bojax.envs.settings.CliffWalking`.
    """

    num_actions: ClassVar[int] = 4
    num_branches: ClassVar[int] = 5

    slip: Float[Array, ""]
    reward_scale: Float[Array, ""]
    reward: Literal["goal-only", "classic"] = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    @property
    @override
    def observation_space(self) -> Discrete:
        return Discrete(ROWS * COLUMNS)

    @override
    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return jnp.full((), START, jnp.int32)

    @override
    def probabilities(self, state: Int[Array, ""], action: Int[Array, ""]) -> Float[Array, "5"]:
        """The intended direction, then each of the four directions that a slip may draw."""
        return jnp.append(1.0 - self.slip, jnp.broadcast_to(self.slip / 4.0, (4,)))

    @override
    def outcome(self, state: Int[Array, ""], action: Int[Array, ""], branch: Int[Array, ""]) -> TimeStep:
        direction = jnp.where(branch == 0, action, branch - 1)
        row = jnp.clip(state // COLUMNS + jnp.asarray(ROW_STEPS, jnp.int32)[direction], 0, ROWS - 1)
        column = jnp.clip(state % COLUMNS + jnp.asarray(COLUMN_STEPS, jnp.int32)[direction], 0, COLUMNS - 1)
        cell = row * COLUMNS + column
        falls = (cell > START) & (cell < GOAL)
        is_goal = cell == GOAL
        if self.reward == "classic":
            reward = jnp.where(falls, -100.0, -1.0).astype(self.reward_scale.dtype)
        else:
            reward = is_goal.astype(self.reward_scale.dtype) - falls.astype(self.reward_scale.dtype)
        return moved_to(jnp.where(falls, START, cell), self.reward_scale * reward, is_goal)
