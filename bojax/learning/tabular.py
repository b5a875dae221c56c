"""Tabular Q-learning with three ways to explore (thesis, Sections 5.3 to 5.5): all share one update."""

import abc
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from bojax.envs.spaces import Discrete, Space
from bojax.learning.balance import Ties, best_action, one_of_the_best
from bojax.learning.base import Balance, Experience, Learner
from bojax.learning.exploration_rewards import ExplorationReward

Q, U = 0, 1
"""Columns of a table's values."""


class Tables(eqx.Module):
    """What a tabular learner knows; one array, since one write a step is faster than three.

    Attributes:
        columns: For each state and action: the expected return Q; the expected exploration return U, where a
            learner has one; and, in the last column, the number of visits.
    """

    columns: Float[Array, "S A C"]

    @property
    def q(self) -> Float[Array, "*N S A"]:
        """Expected return of each action."""
        return self.columns[..., Q]

    @property
    def u(self) -> Float[Array, "*N S A"]:
        """Expected exploration return of each action; 0 where the learner has none."""
        return self.columns[..., U] if self.columns.shape[-1] > 2 else jnp.zeros_like(self.q)

    @property
    def visits(self) -> Float[Array, "*N S A"]:
        """Number of visits of each pair while learning."""
        return self.columns[..., -1]


class TabularLearner(Learner):
    """Q-learning on a table: each value goes `learning_rate` of the way to its target after a step (2.43).

    The target of a value is its reward plus the discounted value of what follows. An absorbing state is worth
    0; a time limit is no absorbing state, and the target is continued past it.

    Attributes:
        discount: Discount of rewards, per step.
        learning_rate: Share of the way to its target that a value goes.
        initial_q: Q of what was never tried; above what can be reached, it is optimism.
        ties: Which of several best actions is taken.
        block: See `Learner`; a loop over steps asks for its end so often.
    """

    discount: Float[Array, ""]
    learning_rate: Float[Array, ""]
    initial_q: Float[Array, ""]
    ties: Ties = eqx.field(static=True)
    block: int = eqx.field(static=True)

    @property
    @abc.abstractmethod
    def initial_values(self) -> Float[Array, "V"]:
        """Q, and U where there is one, of what was never tried."""

    @abc.abstractmethod
    def lesson(
        self,
        key: Key[Array, ""],
        experience: Experience,
        balance: Balance,
        visits: Float[Array, ""],
        next_row: Float[Array, "A C"],
    ) -> tuple[Float[Array, "V"], Float[Array, "V"]]:
        """What each value learns from a step: its reward, and the value of the state that follows.

        Args:
            key: Randomness.
            experience: The step.
            balance: How much is explored.
            visits: Visits of the state and action before.
            next_row: Row of the table of the state that follows.
        """

    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> Tables:
        """See `Learner`.

        Raises:
            ValueError: A space is not discrete.
        """
        del key, capacity
        num_states = _num(observation_space, "observation_space")
        num_actions = _num(action_space, "action_space")
        entry = jnp.append(self.initial_values, 0.0)
        return Tables(jnp.broadcast_to(entry, (num_states, num_actions, *entry.shape)))

    def act(
        self, key: Key[Array, ""], state: Tables, observation: Int[Array, ""], balance: Balance
    ) -> tuple[Int[Array, ""], Float[Array, ""]]:
        """See `Learner`: the best action by Q alone, unless a learner explores by its choice of actions."""
        del balance
        q = _row(state, observation)[:, Q]
        action = best_action(key, q, jnp.zeros_like(q), jnp.zeros_like(self.discount), self.ties)
        return action, q[action]

    def observe(
        self,
        key: Key[Array, ""],
        state: Tables,
        experience: Experience,
        balance: Balance,
        slot: Int[Array, ""],
    ) -> Tables:
        """See `Learner`: the one update of all tabular learners."""
        del slot
        pair = experience.observation, experience.action
        entry = _row(state, experience.observation)[experience.action]
        next_row = _row(state, experience.next_observation)
        reward, next_value = self.lesson(key, experience, balance, entry[-1], next_row)
        change = self.learning_rate * (reward + self.discount * next_value - entry[:-1])
        change = jnp.where(balance.is_learning, jnp.append(change, 1.0), 0.0)
        # One entry is written, nothing is selected: a select would copy the table in every step.
        return Tables(state.columns.at[pair].add(change, mode="drop"))

    def values(
        self, state: Tables, observation: Int[Array, ""], action: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """See `Learner`."""
        entry = _row(state, observation)[action]
        return entry[Q], entry[U] if entry.shape[0] > 2 else jnp.zeros_like(entry[Q])

    @property
    def lanes_on_cpu(self) -> int:
        """See `Learner`: 200 runs of a point fill two cores, and none waits for another point."""
        return 100


class ExplorationValues(TabularLearner):
    """Two values, Q of rewards and U of exploration rewards; acts by argmax Q + kappa U (Algorithm 5).

    Attributes:
        kappa: Weight of U in the choice of actions.
        initial_u: U of what was never tried; exploration rewards are at most 0, so 0 is optimism.
        exploration_reward: What exploring a transition is worth.
        bootstrap: What follows a state. `"policy"`: Q and U of the action that argmax Q + kappa U takes there
            (5.7); then Q + kappa U is the Q of `AdditiveRewards`, number by number, and Q is worth what the
            exploring policy gets. `"greedy-q"`, the default: the greatest Q, as Q-learning has it, and U of
            that action; then Q says what exploitation would get, and exploration can stop at any time.
            `"max"`: the greatest Q and the greatest U of the actions. The last can stay where it is for ever:
            an action that was punished is not taken again, so that its U stays high and goes on promising
            that there is something to explore.
        terminal_u: U of an absorbing state: `"masked"`: 0, as of Q; `"bootstrap"`: what its row of the table
            says, which is never learned and stays `initial_u`. Masking is the default since nothing is left
            to explore after the end of an episode. It makes an early end the best exploration; in the
            domains of Section 5.5 only the goal ends an episode. At an `initial_u` of 0 both are the same.
    """

    kappa: Float[Array, ""]
    initial_u: Float[Array, ""]
    exploration_reward: ExplorationReward
    bootstrap: Literal["greedy-q", "policy", "max"] = eqx.field(static=True)
    terminal_u: Literal["masked", "bootstrap"] = eqx.field(static=True)

    @property
    def exploration_weight(self) -> Float[Array, ""]:
        """See `Learner`: kappa."""
        return self.kappa

    @property
    def initial_values(self) -> Float[Array, "2"]:
        """See `TabularLearner`."""
        return jnp.stack([self.initial_q, self.initial_u])

    def act(
        self, key: Key[Array, ""], state: Tables, observation: Int[Array, ""], balance: Balance
    ) -> tuple[Int[Array, ""], Float[Array, ""]]:
        """See `Learner`."""
        row = _row(state, observation)
        action = self._best(key, row, balance)
        return action, row[action, Q]

    def lesson(
        self,
        key: Key[Array, ""],
        experience: Experience,
        balance: Balance,
        visits: Float[Array, ""],
        next_row: Float[Array, "A 3"],
    ) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
        """See `TabularLearner`."""
        bonus = self.exploration_reward(visits, next_row[:, -1])
        greatest = jnp.max(next_row[:, :-1], axis=0)
        if self.bootstrap == "max":
            next_value = greatest
        else:
            next_value = next_row[self._best(key, next_row, balance), :-1]
            if self.bootstrap == "greedy-q":
                next_value = next_value.at[Q].set(greatest[Q])
        is_worthless = jnp.stack(
            [experience.terminated, experience.terminated & (self.terminal_u == "masked")]
        )
        return jnp.stack([experience.reward, bonus]), jnp.where(is_worthless, 0.0, next_value)

    def _best(self, key: Key[Array, ""], row: Float[Array, "A 3"], balance: Balance) -> Int[Array, ""]:
        return best_action(key, row[:, Q], row[:, U], self.kappa * balance.exploration, self.ties)


class AdditiveRewards(TabularLearner):
    """One value Q, of r + xi r_e (5.1); acts by argmax Q.

    The balance of exploration multiplies xi when a step is learned from: what was learned before stays in Q.

    Attributes:
        xi: Weight of exploration rewards.
        exploration_reward: What exploring a transition is worth.
    """

    xi: Float[Array, ""]
    exploration_reward: ExplorationReward

    @property
    def exploration_weight(self) -> Float[Array, ""]:
        """See `Learner`: xi."""
        return self.xi

    @property
    def initial_values(self) -> Float[Array, "1"]:
        """See `TabularLearner`."""
        return self.initial_q[None]

    def lesson(
        self,
        key: Key[Array, ""],
        experience: Experience,
        balance: Balance,
        visits: Float[Array, ""],
        next_row: Float[Array, "A 2"],
    ) -> tuple[Float[Array, "1"], Float[Array, "1"]]:
        """See `TabularLearner`."""
        del key
        bonus = self.exploration_reward(visits, next_row[:, -1])
        reward = experience.reward + self.xi * balance.exploration * bonus
        return reward[None], _greedy_value(experience, next_row)


class EpsilonGreedy(TabularLearner):
    """One value Q of rewards; acts by argmax Q, but uniformly with probability epsilon.

    Attributes:
        epsilon: That probability.
    """

    epsilon: Float[Array, ""]

    @property
    def exploration_weight(self) -> Float[Array, ""]:
        """See `Learner`: epsilon."""
        return self.epsilon

    @property
    def initial_values(self) -> Float[Array, "1"]:
        """See `TabularLearner`."""
        return self.initial_q[None]

    def act(
        self, key: Key[Array, ""], state: Tables, observation: Int[Array, ""], balance: Balance
    ) -> tuple[Int[Array, ""], Float[Array, ""]]:
        """See `Learner`."""
        row = _row(state, observation)
        # One lot does for both: whether to explore, and which action is taken.
        lot = jax.random.uniform(key, (), row.dtype)
        share = self.epsilon * balance.exploration
        is_random = lot < share
        # What is left of the lot is uniform again; a share of 0 or 1 leaves one of the cases alone.
        of_random = lot / jnp.where(share > 0.0, share, 1.0)
        of_best = (lot - share) / jnp.where(share < 1.0, 1.0 - share, 1.0)
        of_best = jnp.zeros_like(lot) if self.ties == "first" else of_best
        scores = jnp.where(is_random, 0.0, row[:, Q])  # any action is the best one of equals
        action = one_of_the_best(jnp.where(is_random, of_random, of_best), scores)
        return action, row[action, Q]

    def lesson(
        self,
        key: Key[Array, ""],
        experience: Experience,
        balance: Balance,
        visits: Float[Array, ""],
        next_row: Float[Array, "A 2"],
    ) -> tuple[Float[Array, "1"], Float[Array, "1"]]:
        """See `TabularLearner`."""
        del key, balance, visits
        return experience.reward[None], _greedy_value(experience, next_row)


def _num(space: Space, name: str) -> int:
    if not isinstance(space, Discrete):
        raise ValueError(f"{name}: a tabular learner needs a Discrete space, got a {type(space).__name__}")
    return space.num


def _row(state: Tables, observation: Int[Array, ""]) -> Float[Array, "A C"]:
    """The row of a state; of the nearest one for a number outside."""
    return state.columns.at[observation].get(mode="clip")


def _greedy_value(experience: Experience, next_row: Float[Array, "A 2"]) -> Float[Array, "1"]:
    return jnp.where(experience.terminated, 0.0, jnp.max(next_row[:, Q]))[None]
