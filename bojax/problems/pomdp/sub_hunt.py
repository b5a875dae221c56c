"""Sub Hunt: find a submarine that crosses a grid, and engage it before it escapes (SubHunt.jl, Sunberg)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.problems.actions import Discrete
from bojax.problems.pomdp.readings import Beams, ReadingProblem, beam_towards, length_of
from bojax.problems.pomdp.sub_hunt_values import Rules, solve
from bojax.results.outline import Outline

PING, ENGAGE = 4, 5

_HEADINGS = np.asarray([(0, 1), (1, 0), (0, -1), (-1, 0)], np.int32)
"""North, east, south and west."""

_OWN_MOVES = np.concatenate([_HEADINGS, np.zeros((2, 2), np.int32)])
"""Directions of the own move of each action."""

_TARGET_MOVES = np.stack(
    [2 * _HEADINGS, _HEADINGS + np.roll(_HEADINGS, 1, axis=0), _HEADINGS + np.roll(_HEADINGS, -1, axis=0)], 1
)
"""Moves of the target, by its direction: two cells ahead, or one ahead and one to the left or the right."""


class SubHunt(ReadingProblem):
    """Two submarines on a grid of cells from 1 to `size`; the target heads for the opposite edge.

    A state is the own position, the target's, its direction (north, east, south, west: 0 to 3), and whether
    the target is aware of being hunted. An action is one of these directions, to move, or to ping (4), which
    makes the target aware, or to engage (5). A kill ends the episode, as does the target at its edge.

    Settings: `bojax.problems.pomdp.settings.SubHunt`.
    """

    straight_probability: Float[Array, ""]
    kill_radius: Float[Array, ""]
    kill_probability: Float[Array, ""]
    kill_reward: Float[Array, ""]
    ping_noise: Float[Array, ""]
    detection_radius: Float[Array, ""]
    detection_noise: Float[Array, ""]
    empty_noise: Float[Array, ""]
    discount: Float[Array, ""]
    size: int = eqx.field(static=True)
    speed: int = eqx.field(static=True)
    num_beams: int = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    # Optimal value of each action at each state, with states observed; None to compute it
    action_values: Float[Array, "X Y X Y 4 2 6"] | None = None

    def __post_init__(self) -> None:
        if self.action_values is None:
            found = solve(self._rules()).reshape(*(self.size,) * 4, 4, 2, 6)
            self.action_values = jnp.asarray(found, self.discount.dtype)

    @override
    def sketch(self, state: Float[Array, "6"]) -> dict[str, Float[Array, "2"]]:
        return {"own": state[:2], "target": state[2:4]}

    @override
    def outline(self) -> Outline:
        low, high = 0.5, self.size + 0.5
        return Outline(border=(low, low, high, high))

    @property
    @override
    def actions(self) -> Discrete:
        return Discrete(jnp.arange(6, dtype=jnp.int32).astype(self.discount.dtype)[:, None])

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "6"]:
        direction_key, start_key = jax.random.split(key)
        direction = jax.random.randint(direction_key, (), 0, 4, jnp.int32)
        start = jax.random.randint(start_key, (), 1, self.size + 1, jnp.int32)
        heading = self._heading(direction)
        edge = jnp.where(jnp.sum(heading) > 0, 1, self.size)
        target = jnp.where(heading == 0, start, edge)
        middle = jnp.full(2, round(self.size / 2), jnp.int32)
        state = jnp.concatenate([middle, target, direction[None], jnp.zeros(1, jnp.int32)])
        return state.astype(self.discount.dtype)

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "6"], action: Float[Array, "1"]
    ) -> tuple[Float[Array, "6"], Float[Array, ""], Bool[Array, ""]]:
        move_draw, kill_draw = jax.random.uniform(key, (2,), state.dtype)
        own, targets, aware, kill = self.outcomes(state.astype(jnp.int32), action[0].astype(jnp.int32))
        drawn = jnp.sum(move_draw >= jnp.cumsum(self.probabilities())[:-1], dtype=jnp.int32)
        killed = kill_draw < kill
        next_state = jnp.concatenate([own, targets[drawn], state[4:5].astype(jnp.int32), aware[None]])
        reward = jnp.where(killed, self.kill_reward, 0.0)
        return next_state.astype(state.dtype), reward, killed | self.has_escaped(next_state)

    @override
    def heuristic_value(self, state: Float[Array, "6"]) -> Float[Array, ""]:
        return jnp.max(self.values_at(state))

    def values_at(self, state: Float[Array, "6"]) -> Float[Array, "6"]:
        """Optimal value of each action with states observed."""
        assert self.action_values is not None
        index = state.astype(jnp.int32)
        return self.action_values[(*(index[i] - 1 for i in range(4)), index[4], index[5])]

    def outcomes(
        self, state: Int[Array, "6"], action: Int[Array, ""]
    ) -> tuple[Int[Array, "2"], Int[Array, "T 2"], Int[Array, ""], Float[Array, ""]]:
        """The own next position, the target's possible ones, its awareness, and the probability of a kill."""
        own = self._clamp(state[:2] + self.speed * jnp.asarray(_OWN_MOVES)[action])
        targets = self._clamp(state[None, 2:4] + jnp.asarray(_TARGET_MOVES)[state[4]])
        aware = jnp.where(action == PING, 1, state[5])
        offset = (state[2:4] - state[:2]).astype(self.discount.dtype)
        in_reach = (action == ENGAGE) & (length_of(offset) <= self.kill_radius)
        kill = jnp.where(state[5] == 1, self.kill_probability, 1.0)
        return own, targets, aware, jnp.where(in_reach, kill, 0.0)

    def probabilities(self) -> Float[Array, "T"]:
        """Probabilities of the target's moves."""
        aside = 0.5 * (1.0 - self.straight_probability)
        return jnp.stack([self.straight_probability, aside, aside])

    def has_escaped(self, state: Int[Array, "6"]) -> Bool[Array, ""]:
        """Whether the target has reached its edge."""
        heading = self._heading(state[4])
        edge = jnp.where(jnp.sum(heading) > 0, self.size, 1)
        return jnp.any((heading != 0) & (state[2:4] == edge))

    def _rules(self) -> Rules:
        """The problem as tables over the cells, in the order of x and then y."""
        cells = np.indices((self.size, self.size), np.int32).reshape(2, -1).T + 1

        def numbers(positions: Int[np.ndarray, "*N 2"]) -> Int[np.ndarray, "*N"]:
            return (np.clip(positions, 1, self.size) - 1) @ np.asarray([self.size, 1])

        nearest_first = np.argsort(-(cells @ _HEADINGS.T), axis=0, kind="stable")
        offsets = (cells[None] - cells[:, None]).astype(self.discount.dtype)
        is_near = np.sqrt((offsets**2).sum(axis=2)) <= np.asarray(self.kill_radius)
        return Rules(
            own=numbers(cells[:, None] + self.speed * _OWN_MOVES),
            targets=numbers(cells[:, None, None] + _TARGET_MOVES),
            probabilities=np.asarray(self.probabilities(), np.float64),
            lines=nearest_first.T.reshape(4, self.size, self.size),
            kill=np.where(is_near[:, :, None], [1.0, float(self.kill_probability)], 0.0),
            kill_reward=float(self.kill_reward),
            discount=float(self.discount),
        )

    def _heading(self, direction: Int[Array, ""]) -> Int[Array, "2"]:
        return jnp.asarray(_HEADINGS)[direction]

    def _clamp(self, position: Int[Array, "*N 2"]) -> Int[Array, "*N 2"]:
        return jnp.clip(position, 1, self.size)

    @override
    def reading(self, action: Float[Array, "1"], next_state: Float[Array, "6"]) -> Beams:
        offset = next_state[2:4] - next_state[:2]
        distance, pings = length_of(offset), action[0] == PING
        detected = distance <= self.detection_radius
        other_mean = jnp.where(pings, self.size, self.detection_radius)
        other_noise = jnp.where(pings, self.ping_noise, self.empty_noise)
        noise = jnp.where(pings, self.ping_noise, jnp.where(detected, self.detection_noise, other_noise))
        mean = jnp.where(pings | detected, distance, other_mean)
        index = beam_towards(offset, self.num_beams)
        return Beams(index, mean, noise, other_mean, other_noise, self.num_beams)
