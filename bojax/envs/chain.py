"""The chain that is hard to explore (Osband et al. 2014; thesis, Section 5.7.1 and Fig. 5.6a)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.envs.base import TimeStep
from bojax.envs.spaces import Discrete
from bojax.envs.tabular import TabularEnv, moved_to

LEFT, RIGHT = 0, 1


class Chain(TabularEnv):
    """Walk a chain of N states to its end.

    Action left moves left; action right moves right with probability 1 - 1/N, else left. In the first state,
    a move to the left has no effect. The last state is the goal: it pays 1 and is terminal. A step to any
    other state pays -1 with probability 1 - p, drawn anew in each step. (The text of the thesis says that
    p = 0 gives goal-only rewards; by its formula it is p = 1.)

    The length is an array leaf, so that chains of all lengths share one compiled program; only `max_length`
    is built into it. States are numbered from 0, and those from N on are never visited: their rows of a table
    never change. For a learner that scales observations by their declared bounds, neighbours are at the same
    distance, 1 / (`max_length` - 1), in every chain.

    Settings: `bojax.envs.settings.Chain`.
    """

    num_actions: ClassVar[int] = 2
    num_branches: ClassVar[int] = 4

    length: Float[Array, ""]
    sparsity: Float[Array, ""]
    start: Float[Array, ""]
    max_length: int = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    @property
    @override
    def observation_space(self) -> Discrete:
        return Discrete(self.max_length)

    @override
    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return self.start.astype(jnp.int32)

    @override
    def probabilities(self, state: Int[Array, ""], action: Int[Array, ""]) -> Float[Array, "4"]:
        """The intended direction without and with the additional -1, then the opposite direction likewise."""
        slip = jnp.where(action == RIGHT, 1.0 / self.length, 0.0)
        free, paid = self.sparsity, 1.0 - self.sparsity
        return jnp.stack([(1.0 - slip) * free, (1.0 - slip) * paid, slip * free, slip * paid])

    @override
    def outcome(self, state: Int[Array, ""], action: Int[Array, ""], branch: Int[Array, ""]) -> TimeStep:
        goal = self.length.astype(jnp.int32) - 1
        is_right = (action == RIGHT) & (branch < 2)
        after = jnp.clip(jnp.where(is_right, state + 1, state - 1), 0, goal)
        is_goal = after == goal
        penalty = ((branch == 1) | (branch == 3)).astype(self.length.dtype)
        return moved_to(after, jnp.where(is_goal, 1.0, -penalty), is_goal)
