"""Taxi (Dietterich 2000), goal-only as in Section 5.5 of the thesis, p. 119."""

from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.envs.base import TimeStep
from bojax.envs.spaces import Discrete
from bojax.envs.tabular import TabularEnv, moved_to

SIZE = 5
PLACES = (0, 4, 20, 23)  # cells of the places red, green, yellow and blue; cells are numbered row by row
ABOARD = 4  # position of a passenger in the taxi; positions 0 to 3 are the places
WALLS = (1, 6, 15, 17, 20, 22)  # cells with a wall on their east side, besides the border

SOUTH, NORTH, EAST, WEST, PICK_UP, DROP_OFF = range(6)


class Taxi(TabularEnv):
    """Fetch a passenger at one of four places of a 5 x 5 grid and bring them to another.

        +---------+
        |R: | : :G|
        | : | : : |
        | : : : : |
        | | : | : |
        |Y| : |B: |
        +---------+

    States, `((row * 5 + column) * 5 + passenger) * 4 + destination`, and actions, south, north, east, west,
    pick up and drop off, are numbered as in Gymnasium's `Taxi`. As there, the initial state is drawn from the
    300 states where the passenger waits at a place other than the destination. A passenger who is dropped off
    at a wrong place waits there.

    Settings: `bojax.envs.settings.Taxi`.
    """

    num_actions: ClassVar[int] = 6
    num_branches: ClassVar[int] = 1

    reward_scale: Float[Array, ""]
    reward: Literal["goal-only", "classic"] = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    @property
    @override
    def observation_space(self) -> Discrete:
        return Discrete(500)

    @override
    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        draw = jax.random.randint(key, (), 0, 300, jnp.int32)
        cell, passenger, ahead = draw // 12, draw // 3 % 4, draw % 3
        return (cell * 5 + passenger) * 4 + (passenger + 1 + ahead) % 4

    @override
    def probabilities(self, state: Int[Array, ""], action: Int[Array, ""]) -> Float[Array, "1"]:
        return jnp.ones((1,), self.reward_scale.dtype)

    @override
    def outcome(self, state: Int[Array, ""], action: Int[Array, ""], branch: Int[Array, ""]) -> TimeStep:
        cell, passenger, destination = state // 20, state // 4 % 5, state % 4
        row, column = cell // SIZE, cell % SIZE
        is_pick_up, is_drop_off = action == PICK_UP, action == DROP_OFF

        is_aboard = passenger == ABOARD
        place = _place(cell)
        picks_up = is_pick_up & (place == passenger)
        drops_off = is_drop_off & is_aboard & (place >= 0)
        arrives = drops_off & (place == destination)
        passenger = jnp.where(picks_up, ABOARD, jnp.where(drops_off, place, passenger))

        goes_east = (action == EAST) & (column < SIZE - 1) & ~_is_any(cell, WALLS)
        goes_west = (action == WEST) & (column > 0) & ~_is_any(cell - 1, WALLS)
        goes_south = (action == SOUTH) & (row < SIZE - 1)
        goes_north = (action == NORTH) & (row > 0)
        move = jnp.where(goes_east, 1, 0) - jnp.where(goes_west, 1, 0)
        move = move + jnp.where(goes_south, SIZE, 0) - jnp.where(goes_north, SIZE, 0)

        if self.reward == "classic":
            is_wrong = (is_pick_up & ~picks_up) | (is_drop_off & ~drops_off)
            right, wrong, else_ = 20.0, -10.0, -1.0
        else:
            is_wrong = (is_pick_up & ~picks_up) | (is_drop_off & ~arrives)
            right, wrong, else_ = 1.0, -0.1, 0.0
        reward = jnp.where(arrives, right, jnp.where(is_wrong, wrong, else_))
        after = ((cell + move) * 5 + passenger) * 4 + destination
        return moved_to(after, self.reward_scale * reward.astype(self.reward_scale.dtype), arrives)


def _place(cell: Int[Array, ""]) -> Int[Array, ""]:
    """Number of the place at a cell; -1 elsewhere."""
    place = jnp.full((), -1, jnp.int32)
    for number, at in enumerate(PLACES):
        place = jnp.where(cell == at, number, place)
    return place


def _is_any(cell: Int[Array, ""], cells: tuple[int, ...]):
    found = jnp.zeros((), bool)
    for at in cells:
        found = found | (cell == at)
    return found
