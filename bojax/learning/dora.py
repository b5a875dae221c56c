"""DORA: exploration by E-values, generalised visit counters (Fox, Choshen and Loewenstein, ICLR 2018)."""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Box, Space
from bojax.learning.actions import grid_actions, nearest_action
from bojax.learning.base import Episode, ExplorationState, Learner, Transition
from bojax.learning.policy import best_action
from bojax.learning.tile_coding import TileTable, is_first, tiles
from bojax.numerics.choices import Choice, one_of

Q, E = 0, 1  # columns of the weights
_NONE = -1  # index of the next action before one has been chosen


class DORAState(eqx.Module):
    """The state of `DORA`."""

    table: TileTable  # indices of the tiles seen so far
    weights: Float[Array, "N 2"]  # weights of Q and of the E-values
    actions: Action
    scale: Float[Array, "D"]  # factor of each observation that gives a tile side 1
    # Index of the action that was chosen for the next training step; -1 before an episode
    next_action: Int[Array, ""]


class DORA(Learner):
    """Q-learning on tiles, explored by E-values: values of a reward of 0, learned by SARSA from E = 1/2.

    The E-value of a state-action pair falls with every visit of the pair and of what follows it. log E over
    log(1 - alpha_E) is therefore a generalised visit counter. E enters the policy argmax Q - T log(-log E)
    (LLL), or, with weight `xi`, the reward, as the bonus log(1 - alpha_E) / log E of the updated E; or both.

    As in the published code, the next action of a training episode is chosen before the update and taken
    after it, and a truncated episode is bootstrapped. Deviations: a state of a discrete space has tiles of
    its own, and the table hashes by 32 bits instead of Python's hash.

    With `e_values: linear`, on a discrete space with one tiling, E is the table of Section 3 of the paper,
    and the counter is the number of visits if `e_discount` is 0.

    Settings: `bojax.learning.settings.DORA`.
    """

    # Four chunks of 200 lanes at once take 1.3 times as long on an H200 as one: a step is many small kernels.
    narrowest: ClassVar[int] = 400

    discount: Float[Array, ""]
    e_discount: Float[Array, ""]
    learning_rate: Float[Array, ""]
    e_learning_rate: Float[Array, ""]
    policy: Choice = eqx.field(converter=one_of("lll", "epsilon-greedy"))
    temperature: Float[Array, ""]
    epsilon: Float[Array, ""]
    xi: Float[Array, ""]
    e_values: Choice = eqx.field(converter=one_of("sigmoid", "linear"))
    derivative: Choice = eqx.field(converter=one_of("at-e", "at-logit"))
    initial_weight: Float[Array, ""]
    num_tilings: int = eqx.field(static=True)
    num_indices: int = eqx.field(static=True)
    actions_per_dimension: int = eqx.field(static=True)
    block: int = eqx.field(static=True)

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        return jnp.where(self.policy.is_("lll"), self.temperature, self.epsilon)

    @override
    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        if not isinstance(observation_space, Box):
            return
        if not bool(jnp.all(jnp.isfinite(observation_space.high - observation_space.low))):
            raise ValueError("observation_space: tiles need finite bounds, since they are parts of a range")

    @override
    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> DORAState:
        dtype = self.discount.dtype
        scale = jnp.ones((1,), dtype)
        if isinstance(observation_space, Box):
            scale = self.num_tilings / (observation_space.high - observation_space.low).astype(dtype)
        actions = grid_actions(self.actions_per_dimension, action_space)
        weights = jnp.zeros((self.num_indices, 2), dtype)
        initial = self.initial_weight * jax.random.normal(key, (self.num_indices,), dtype)
        return DORAState(
            table=TileTable.empty(self.num_indices, self.num_tilings, len(actions)),
            weights=weights.at[:, Q].set(initial),
            actions=actions,
            scale=scale,
            next_action=jnp.full((), _NONE, jnp.int32),
        )

    @override
    def act(
        self, key: Key[Array, ""], state: DORAState, observation: Observation, exploration: ExplorationState
    ) -> tuple[Action, Float[Array, ""]]:
        """The action that `observe` chose; in the first step of an episode and in tests, one of the policy.

        `observe` chooses with the exploration state of training, which must not be used in a test.
        """
        _, index = state.table.look_up(self._tiles(state, observation))
        sums = _sums(state.weights, index)
        chosen = self._choose(key, sums, exploration)
        has_chosen = exploration.is_learning & (state.next_action != _NONE)
        action = jnp.where(has_chosen, state.next_action, chosen)
        return state.actions[action], sums[action, Q]

    @override
    def observe(
        self,
        key: Key[Array, ""],
        state: DORAState,
        transition: Transition,
        exploration: ExplorationState,
        step_in_block: Int[Array, ""],
    ) -> DORAState:
        learns, continues = exploration.is_learning, ~transition.terminated
        action = nearest_action(state.actions, transition.action)
        table, index = state.table.look_up(self._tiles(state, transition.observation), learns)
        place = index[action]
        next_tiles = self._tiles(state, transition.next_observation)
        table, next_index = table.look_up(next_tiles, learns & continues)
        q, logit = _sums(state.weights, place)
        next_sums = _sums(state.weights, next_index)
        next_action = self._choose(key, next_sums, exploration)

        # E is learned by SARSA, with a reward of 0. Each tile counts once, even if two share an index; rates
        # are divided by the number of tilings, as the sum over the tiles changes by as many steps. E and Q of
        # a terminal state are 0.
        e, next_e = self._e(logit), self._e(next_sums[next_action, E])
        rate, counted = self.e_learning_rate / self.num_tilings, is_first(place)  # alpha_E
        e_error = jnp.where(continues, self.e_discount * next_e, 0.0) - e
        e_step = rate * e_error * self._slope(e, continues)
        logit = logit + e_step * jnp.sum(counted, dtype=e_step.dtype)

        # Q is learned by Q-learning; the bonus is the inverse of the counter, after the update of E.
        bonus = jnp.log1p(-rate) / self._log_e(logit)
        reward = transition.reward + self.xi * exploration.scale * bonus
        target = reward + jnp.where(continues, self.discount * jnp.max(next_sums[:, Q]), 0.0)
        q_step = self.learning_rate / self.num_tilings * (target - q)

        steps = jnp.where((learns & counted)[:, None], jnp.stack([q_step, e_step])[None, :], 0.0)
        next_action = jnp.where(continues, next_action, _NONE)
        next_action = jnp.where(learns, next_action, state.next_action)
        return replace(
            state, table=table, weights=state.weights.at[place].add(steps), next_action=next_action
        )

    @property
    @override
    def learns_from_episodes(self) -> bool:
        return type(self).end_episode is not DORA.end_episode

    @override
    def end_episode(
        self, key: Key[Array, ""], state: DORAState, episode: Episode, exploration: ExplorationState
    ) -> DORAState:
        """Discard the action chosen for the step after a time limit."""
        next_action = jnp.where(exploration.is_learning, _NONE, state.next_action)
        return eqx.tree_at(lambda s: s.next_action, state, next_action)

    @override
    def values(
        self, state: DORAState, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Q, and -log(-log E) as U."""
        _, index = state.table.look_up(self._tiles(state, observation))
        q, logit = _sums(state.weights, index[nearest_action(state.actions, action)])
        return q, -self._log_negative_log_e(logit)

    def _tiles(self, state: DORAState, observation: Observation) -> Int[Array, "T C"]:
        x = jnp.atleast_1d(observation).astype(state.scale.dtype)
        return tiles(state.scale * x, self.num_tilings)

    def _choose(
        self, key: Key[Array, ""], sums: Float[Array, "A 2"], exploration: ExplorationState
    ) -> Int[Array, ""]:
        """The index of an action: argmax Q - T log(-log E), or epsilon-greedy."""
        keys = jax.random.split(key, 3)
        q, weight = sums[:, Q], exploration.scale * self.exploration_weight
        lll = best_action(keys[0], q - weight * self._log_negative_log_e(sums[:, E]))
        is_random = jax.random.uniform(keys[1], (), q.dtype) < weight
        random = jax.random.randint(keys[2], (), 0, len(q), jnp.int32)
        # As in the published code, the first of several best actions here; LLL breaks ties at random.
        greedy = jnp.where(is_random, random, jnp.argmax(q).astype(jnp.int32))
        return jnp.where(self.policy.is_("lll"), lll, greedy)

    def _e(self, logit: Float[Array, "*N"]) -> Float[Array, "*N"]:
        return jnp.where(self.e_values.is_("sigmoid"), jax.nn.sigmoid(logit), 1.0 + logit)

    def _slope(self, e: Float[Array, ""], continues: Bool[Array, ""]) -> Float[Array, ""]:
        """dE/dw, or its replacement in the published code."""
        # The derivative of the sigmoid, s(z) (1 - s(z)), at the logit z, where s(z) is E; or at E in place of
        # z, an error of the published code before the end of an episode.
        at = jnp.where(self.derivative.is_("at-e") & continues, jax.nn.sigmoid(e), e)
        return jnp.where(self.e_values.is_("sigmoid"), at * (1.0 - at), 1.0)

    def _log_e(self, logit: Float[Array, "*N"]) -> Float[Array, "*N"]:
        linear = jnp.log(_inside(1.0 + logit))
        return jnp.where(self.e_values.is_("sigmoid"), jax.nn.log_sigmoid(logit), linear)

    def _log_negative_log_e(self, logit: Float[Array, "*N"]) -> Float[Array, "*N"]:
        linear = jnp.log(-jnp.log(_inside(1.0 + logit)))
        return jnp.where(self.e_values.is_("sigmoid"), log_softplus(-logit), linear)


def log_softplus(x: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """log(log(1 + e^x)), without underflow: x - e^x / 2 for small e^x. At x = -logit, it is log(-log E)."""
    is_small = x < -20.0
    return jnp.where(is_small, x - 0.5 * jnp.exp(x), jnp.log(jax.nn.softplus(jnp.where(is_small, 0.0, x))))


def _inside(e: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """E strictly between 0 and 1, so that log E and log(-log E) are finite."""
    limits = jnp.finfo(e.dtype)
    return jnp.clip(e, limits.tiny, 1.0 - limits.eps)


def _sums(weights: Float[Array, "N 2"], index: Int[Array, "*A T"]) -> Float[Array, "*A 2"]:
    """The sums w'phi of Q and of the E-values, where phi is 1 for every index."""
    return jnp.sum(jnp.where(is_first(index)[..., None], weights[index], 0.0), axis=-2)
