"""A hallway with doors that look the same: find out where you are, then stop at the right one."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.problems.actions import Box
from bojax.problems.pomdp.readings import BinaryReading, ReadingProblem
from bojax.results.outline import Outline


class Hallway(ReadingProblem):
    """A position between two walls, moves of up to 1 m, and two sensors, of a door and of a wall beside.

    A move shorter than `stop` enters the door beside the robot and ends the episode: it pays 1 at the last
    door of the list, and `wrong_reward` anywhere else. Each sensor is right with probability `accuracy`; a
    reading is 0 or 1. The problem is in the spirit of the corridor of Porta et al., Point-based value
    iteration for continuous POMDPs (JMLR 2006), with constants of its own.

    Settings: `bojax.problems.pomdp.settings.Hallway`.
    """

    has_discrete_observations: ClassVar[bool] = True

    length: Float[Array, ""]
    doors: Float[Array, "N"]
    half_width: Float[Array, ""]
    stop: Float[Array, ""]
    wrong_reward: Float[Array, ""]
    move_noise: Float[Array, ""]
    accuracy: Float[Array, ""]
    discount: Float[Array, ""]
    max_steps: int = eqx.field(static=True)

    @property
    @override
    def actions(self) -> Box:
        one = jnp.ones(1, self.length.dtype)
        return Box(-one, one)

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "1"]:
        return jax.random.uniform(key, (1,), self.length.dtype, 0.0, self.length)

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "1"], action: Float[Array, "1"]
    ) -> tuple[Float[Array, "1"], Float[Array, ""], Bool[Array, ""]]:
        stops = jnp.abs(action[0]) < self.stop
        is_right = jnp.abs(state[0] - self.doors[-1]) <= self.half_width
        reward = jnp.where(stops, jnp.where(is_right, 1.0, self.wrong_reward), 0.0).astype(state.dtype)
        moved = state + action + self.move_noise * jax.random.normal(key, (1,), state.dtype)
        return jnp.where(stops, state, jnp.clip(moved, 0.0, self.length)), reward, stops

    @override
    def reading(self, action: Float[Array, "1"], next_state: Float[Array, "1"]) -> BinaryReading:
        return BinaryReading(self._beside(next_state), self.accuracy)

    @override
    def sketch(self, state: Float[Array, "1"]) -> dict[str, Float[Array, "1"]]:
        return {"position": state}

    @override
    def outline(self) -> Outline:
        door = self.doors[-1]
        return Outline(goals=[(0.0, door - self.half_width, self.max_steps, door + self.half_width)])

    def _beside(self, state: Float[Array, "1"]) -> Float[Array, "2"]:
        """Whether there is a door, and a wall, beside a position: 0 or 1."""
        door = jnp.any(jnp.abs(state - self.doors) <= self.half_width)
        wall = jnp.minimum(state[0], self.length - state[0]) <= self.half_width
        return jnp.stack([door, wall]).astype(state.dtype)
