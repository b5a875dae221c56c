"""Tabular Q-learning with three ways to explore, which share one update (thesis, Sections 5.3 to 5.5)."""

import abc
from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.envs.spaces import Discrete, Space
from bojax.learning.base import ExplorationState, Learner, Transition
from bojax.learning.exploration_rewards import ExplorationReward
from bojax.learning.policy import Ties, best_action, random_argmax

Q, U = 0, 1  # columns of the table


class Tables(eqx.Module):
    """The state of a tabular learner, in one array: one write per step is faster than three."""

    # For each state and action: the expected return Q, the expected exploration return U where the learner
    # has one, and, in the last column, the number of visits
    columns: Float[Array, "S A C"]

    @property
    def q(self) -> Float[Array, "*N S A"]:
        """Expected return of each action."""
        return self.columns[..., Q]

    @property
    def u(self) -> Float[Array, "*N S A"]:
        """Expected exploration return of each action; 0 for a learner without U."""
        return self.columns[..., U] if self.columns.shape[-1] > 2 else jnp.zeros_like(self.q)

    @property
    def visits(self) -> Float[Array, "*N S A"]:
        """Number of visits of each state-action pair while learning."""
        return self.columns[..., -1]


class TabularLearner(Learner):
    """Q-learning on a table: each step moves a value by `learning_rate` towards its TD target (2.43).

    The value of a terminal state is 0. A time limit is not terminal: the target bootstraps past it.
    """

    # The 200 runs of a point then fill two cores.
    lanes_on_cpu: ClassVar[int] = 100
    # Episodes on an H200 take 4.3 ms with 200 lanes and 8.5 with 1,000: their fixed cost is that of some 600.
    narrowest: ClassVar[int] = 200
    # Whether `act` and `td_target` read no other row of the table than those they are given a state for. A
    # class says so itself; on a GPU, its episodes are kernels unless it overrides `observe` or `flush`.
    reads_one_row: ClassVar[bool] = False

    discount: Float[Array, ""]
    learning_rate: Float[Array, ""]
    initial_q: Float[Array, ""]
    ties: Ties = eqx.field(static=True)
    block: int = eqx.field(static=True)

    @property
    def initial_values(self) -> Float[Array, "V"]:
        """Initial Q, followed by the initial U of a learner with U."""
        return self.initial_q[None]

    @abc.abstractmethod
    def td_target(
        self,
        key: Key[Array, ""],
        transition: Transition,
        exploration: ExplorationState,
        visits: Float[Array, ""],
        next_row: Float[Array, "A C"],
    ) -> Float[Array, "V"]:
        """The TD target of each value: its reward plus the discounted value of the next state.

        `visits` counts earlier visits of the state-action pair; `next_row` is the table's row of the next
        state.
        """

    @override
    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        _num(observation_space, "observation_space")
        _num(action_space, "action_space")

    @override
    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> Tables:
        """Tables of the initial values.

        Raises:
            ValueError: A space is not discrete.
        """
        num_states = _num(observation_space, "observation_space")
        num_actions = _num(action_space, "action_space")
        entry = jnp.append(self.initial_values, 0.0)
        return Tables(jnp.broadcast_to(entry, (num_states, num_actions, *entry.shape)))

    @override
    def observe(
        self,
        key: Key[Array, ""],
        state: Tables,
        transition: Transition,
        exploration: ExplorationState,
        step_in_block: Int[Array, ""],
    ) -> Tables:
        """The TD update that all tabular learners share."""
        row = _row(state, transition.observation)
        next_row = _row(state, transition.next_observation)
        change = self.change(key, transition, exploration, row, next_row)
        # The entry is updated by adding 0 where nothing is learned: a select would copy the whole table.
        pair = transition.observation, transition.action
        return Tables(state.columns.at[pair].add(change, mode="drop", wrap_negative_indices=False))

    def change(
        self,
        key: Key[Array, ""],
        transition: Transition,
        exploration: ExplorationState,
        row: Float[Array, "A C"],
        next_row: Float[Array, "A C"],
    ) -> Float[Array, "C"]:
        """What a transition adds to the entry of its pair, from the rows of both states in the table."""
        entry = row[transition.action]
        target = self.td_target(key, transition, exploration, entry[-1], next_row)
        change = self.learning_rate * (target - entry[:-1])
        return jnp.where(exploration.is_learning, jnp.append(change, 1.0), 0.0)

    @override
    def values(
        self, state: Tables, observation: Int[Array, ""], action: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        entry = _row(state, observation)[action]
        return entry[Q], entry[U] if entry.shape[0] > 2 else jnp.zeros_like(entry[Q])


class ExplorationValues(TabularLearner):
    """Separate values Q of rewards and U of exploration rewards; acts by argmax Q + kappa U (Algorithm 5).

    Settings: `bojax.learning.settings.ExplorationValues`.
    """

    reads_one_row: ClassVar[bool] = True

    kappa: Float[Array, ""]
    initial_u: Float[Array, ""]
    exploration_reward: ExplorationReward
    bootstrap: Literal["greedy-q", "policy", "max"] = eqx.field(static=True)
    terminal_u: Literal["masked", "bootstrap"] = eqx.field(static=True)

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        return self.kappa

    @property
    @override
    def initial_values(self) -> Float[Array, "2"]:
        return jnp.stack([self.initial_q, self.initial_u])

    @override
    def act(
        self, key: Key[Array, ""], state: Tables, observation: Int[Array, ""], exploration: ExplorationState
    ) -> tuple[Int[Array, ""], Float[Array, ""]]:
        row = _row(state, observation)
        action = self._best(key, row, exploration)
        return action, row[action, Q]

    @override
    def td_target(
        self,
        key: Key[Array, ""],
        transition: Transition,
        exploration: ExplorationState,
        visits: Float[Array, ""],
        next_row: Float[Array, "A 3"],
    ) -> Float[Array, "2"]:
        # "policy": Q and U of the action argmax Q + kappa U (5.7). Q + kappa U is then the Q of
        # `AdditiveRewards`, and Q the return of the exploring policy. "greedy-q": the maximum of Q, as in
        # Q-learning, so that Q is the return of exploitation. "max": the maximum of each, with which a run
        # can get stuck: an action that was punished is not taken again, its U stays high, and the state keeps
        # promising exploration.
        bonus = self.exploration_reward(visits, next_row[:, -1])
        greatest = jnp.max(next_row[:, :-1], axis=0)
        if self.bootstrap == "max":
            next_value = greatest
        else:
            next_value = next_row[self._best(key, next_row, exploration), :-1]
            if self.bootstrap == "greedy-q":
                next_value = next_value.at[Q].set(greatest[Q])
        # A masked U is 0, the largest there is: an early end is then the best exploration. In the domains of
        # Section 5.5, only the goal ends an episode.
        is_masked = jnp.stack([transition.terminated, transition.terminated & (self.terminal_u == "masked")])
        rewards = jnp.stack([transition.reward, bonus])
        return rewards + self.discount * jnp.where(is_masked, 0.0, next_value)

    def _best(
        self, key: Key[Array, ""], row: Float[Array, "A 3"], exploration: ExplorationState
    ) -> Int[Array, ""]:
        return best_action(key, row[:, Q] + self.kappa * exploration.scale * row[:, U], self.ties)


class AdditiveRewards(TabularLearner):
    """One value Q, of r + xi r_e (5.1); acts by argmax Q.

    The scale of the exploration state multiplies xi in the TD target: exploration rewards learned in earlier
    episodes stay in Q.

    Settings: `bojax.learning.settings.AdditiveRewards`.
    """

    reads_one_row: ClassVar[bool] = True

    xi: Float[Array, ""]
    exploration_reward: ExplorationReward

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        return self.xi

    @override
    def act(
        self, key: Key[Array, ""], state: Tables, observation: Int[Array, ""], exploration: ExplorationState
    ) -> tuple[Int[Array, ""], Float[Array, ""]]:
        q = _row(state, observation)[:, Q]
        action = best_action(key, q, self.ties)
        return action, q[action]

    @override
    def td_target(
        self,
        key: Key[Array, ""],
        transition: Transition,
        exploration: ExplorationState,
        visits: Float[Array, ""],
        next_row: Float[Array, "A 2"],
    ) -> Float[Array, "1"]:
        bonus = self.exploration_reward(visits, next_row[:, -1])
        reward = transition.reward + self.xi * exploration.scale * bonus
        return reward[None] + self.discount * _greedy_value(transition, next_row)


class EpsilonGreedy(TabularLearner):
    """One value Q of rewards; acts by argmax Q, or uniformly at random with probability epsilon.

    Settings: `bojax.learning.settings.EpsilonGreedy`.
    """

    reads_one_row: ClassVar[bool] = True

    epsilon: Float[Array, ""]

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        return self.epsilon

    @override
    def act(
        self, key: Key[Array, ""], state: Tables, observation: Int[Array, ""], exploration: ExplorationState
    ) -> tuple[Int[Array, ""], Float[Array, ""]]:
        row = _row(state, observation)
        # One uniform draw decides both whether to explore and which action to take: given either outcome of
        # the first decision, the rescaled draw is uniform again.
        draw = jax.random.uniform(key, (), row.dtype)
        probability = self.epsilon * exploration.scale
        is_random = draw < probability
        random_draw = draw / jnp.where(probability > 0.0, probability, 1.0)
        greedy_draw = (draw - probability) / jnp.where(probability < 1.0, 1.0 - probability, 1.0)
        greedy_draw = jnp.zeros_like(draw) if self.ties == "first" else greedy_draw
        scores = jnp.where(is_random, 0.0, row[:, Q])  # equal scores: every action is a tie
        action = random_argmax(jnp.where(is_random, random_draw, greedy_draw), scores)
        return action, row[action, Q]

    @override
    def td_target(
        self,
        key: Key[Array, ""],
        transition: Transition,
        exploration: ExplorationState,
        visits: Float[Array, ""],
        next_row: Float[Array, "A 2"],
    ) -> Float[Array, "1"]:
        return transition.reward[None] + self.discount * _greedy_value(transition, next_row)


def _num(space: Space, name: str) -> int:
    if not isinstance(space, Discrete):
        raise ValueError(
            f"{name}: a tabular learner needs a Discrete space, got a {type(space).__name__}; allowed: "
            "an environment such as chain, cliff-walking or taxi, or another learner"
        )
    return space.num


def _row(state: Tables, observation: Int[Array, ""]) -> Float[Array, "A C"]:
    """The row of a state; an observation out of range is clipped."""
    return state.columns.at[observation].get(mode="clip", wrap_negative_indices=False)


def _greedy_value(transition: Transition, next_row: Float[Array, "A 2"]) -> Float[Array, "1"]:
    return jnp.where(transition.terminated, 0.0, jnp.max(next_row[:, Q]))[None]
