"""A point among walls: a small domain for the study of exploration."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.control import ControlTask
from bojax.envs.spaces import Box

# Walls as x_min, y_min, x_max, y_max. Every wall is 0.1 thick, the longest move along an axis, so that no
# move jumps over one.
WALLS: dict[str, list[tuple[float, float, float, float]]] = {
    "open": [],
    "wall": [(0.45, 0.0, 0.55, 0.8)],
    "maze": [(0.3, 0.0, 0.4, 0.8), (0.6, 0.2, 0.7, 1.0)],
    "rooms": [
        *((0.45, low, 0.55, high) for low, high in ((0.0, 0.15), (0.35, 0.65), (0.85, 1.0))),
        *((low, 0.45, high, 0.55) for low, high in ((0.0, 0.15), (0.35, 0.65), (0.85, 1.0))),
    ],
}
GOALS = {"open": (0.9, 0.9), "wall": (0.9, 0.1), "maze": (0.9, 0.9), "rooms": (0.9, 0.9)}


class PointMaze(ControlTask):
    """Move a point in the unit square from the lower left corner to a disc behind walls.

    An action is a move along x and y, in units of the longest move; the point has no inertia. The two parts
    of a move are made one after the other, and a part that would end inside a wall or outside of the square
    is not made: the point slides along walls. With the layout `wall`, a wall has a gap at its upper end; with
    `maze`, the way is a letter S between two walls; with `rooms`, four rooms have a door of width 0.2 between
    any two neighbours; `open` has no walls.

    The classic reward is -1 a step, including the step that reaches the goal, and the goal ends the episode.
    An episode begins uniformly in a square of side 0.1 around (0.1, 0.1).

    Settings: `bojax.envs.settings.PointMaze`.
    """

    move: Float[Array, ""]
    goal_radius: Float[Array, ""]
    max_steps: int = eqx.field(static=True)
    layout: Literal["open", "wall", "maze", "rooms"] = eqx.field(static=True)

    @property
    @override
    def observation_space(self) -> Box:
        """The position."""
        return Box(jnp.zeros((2,), self.move.dtype), jnp.ones((2,), self.move.dtype))

    @property
    @override
    def action_space(self) -> Box:
        """The move along x and y, in units of the longest move."""
        one = jnp.ones((2,), self.move.dtype)
        return Box(-one, one)

    @override
    def reset(self, key: Key[Array, ""]) -> Float[Array, "2"]:
        return jax.random.uniform(key, (2,), self.move.dtype, 0.05, 0.15)

    @override
    def advance(
        self, key: Key[Array, ""], state: Float[Array, "2"], action: Float[Array, "2"]
    ) -> Float[Array, "2"]:
        """Move along x, then along y."""
        for axis in range(2):
            moved = state.at[axis].add(self.move * action[axis])
            state = jnp.where(self._is_free(moved), moved, state)
        return state

    @override
    def is_goal(self, state: Float[Array, "2"]) -> Bool[Array, ""]:
        offset = state - jnp.asarray(GOALS[self.layout], state.dtype)
        return jnp.sum(offset * offset) <= self.goal_radius**2

    def _is_free(self, position: Float[Array, "2"]) -> Bool[Array, ""]:
        """Whether a position is in the square and in none of the walls."""
        walls = jnp.asarray(np.reshape(WALLS[self.layout], (-1, 4)), position.dtype)
        point = position[None, :]
        is_in_wall = jnp.all((point >= walls[:, :2]) & (point <= walls[:, 2:]), axis=1)
        return jnp.all((position >= 0.0) & (position <= 1.0)) & ~jnp.any(is_in_wall)
