"""Tabular Q-learning with three ways to explore (thesis, Sections 5.3 to 5.5): all share one update."""

import abc
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.spaces import Discrete, Space
from bojax.learning.balance import Ties, best_action
from bojax.learning.base import Balance, Experience, Learner
from bojax.learning.exploration_rewards import ExplorationReward


class Tables(eqx.Module):
    """What a tabular learner knows, a row for each state.

    Attributes:
        q: Expected return Q of each action.
        u: Expected exploration return U; None where a learner has none.
        counts: Visits of each pair; None where a learner needs none.
    """

    q: Float[Array, "S A"]
    u: Float[Array, "S A"] | None
    counts: Float[Array, "S A"] | None


class TabularLearner(Learner):
    """Q-learning on a table: Q(s, a) += rate (target - Q(s, a)) after each step (2.43).

    An absorbing state is worth 0: nothing is added to its reward. A time limit is none: the target is
    continued past it.

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

    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> Tables:
        """See `Learner`.

        Raises:
            ValueError: A space is not discrete.
        """
        del key, capacity
        for name, space in (("observation_space", observation_space), ("action_space", action_space)):
            if not isinstance(space, Discrete):
                raise ValueError(
                    f"{name}: a tabular learner needs a Discrete space, not a {type(space).__name__}"
                )
        assert isinstance(observation_space, Discrete) and isinstance(action_space, Discrete)
        return self._empty(observation_space.num, action_space.num)

    @abc.abstractmethod
    def _empty(self, num_states: int, num_actions: int) -> Tables:
        """Tables before the first step."""

    def _table(self, value: Float[Array, ""], num_states: int, num_actions: int) -> Float[Array, "S A"]:
        return jnp.broadcast_to(value, (num_states, num_actions))

    def act(
        self, key: Key[Array, ""], state: Tables, observation: Int[Array, ""], balance: Balance
    ) -> tuple[Int[Array, ""], Float[Array, ""]]:
        """See `Learner`: the best action by Q alone, unless a learner explores otherwise."""
        del balance
        q = _row(state.q, observation)
        action = best_action(key, q, jnp.zeros_like(q), jnp.zeros_like(self.discount), self.ties)
        return action, q[action]

    def values(
        self, state: Tables, observation: Int[Array, ""], action: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """See `Learner`."""
        q = _row(state.q, observation)[action]
        return q, jnp.zeros_like(q) if state.u is None else _row(state.u, observation)[action]

    def _toward(
        self,
        table: Float[Array, "S A"] | None,
        experience: Experience,
        reward: Float[Array, ""],
        next_value: Float[Array, ""],
        balance: Balance,
    ) -> Float[Array, "S A"]:
        """The one update of all values: a step towards reward + discount * next value."""
        target = reward + self.discount * next_value
        change = self.learning_rate * (target - _row(table, experience.observation)[experience.action])
        return _add(table, experience, change, balance)

    def _masked(self, next_value: Float[Array, ""], terminated: Bool[Array, ""]) -> Float[Array, ""]:
        return jnp.where(terminated, 0.0, next_value)

    @property
    def lanes_on_cpu(self) -> int:
        """See `Learner`."""
        return 128


class ExplorationValues(TabularLearner):
    """Two tables, Q of rewards and U of exploration rewards; acts by argmax Q + kappa U (Algorithm 5).

    Attributes:
        kappa: Weight of U in the choice of actions.
        initial_u: U of what was never tried; exploration rewards are at most 0, so 0 is optimism.
        exploration_reward: What exploring a transition is worth.
        bootstrap: What follows a state: `"max"`: the greatest Q and the greatest U of its actions, as
            Q-learning has it; `"policy"`: Q and U of the action that argmax Q + kappa U takes there (5.7).
        terminal_u: U of an absorbing state: `"masked"`: 0, as of Q; `"bootstrap"`: that of its row of the
            table, which is never learned and stays `initial_u`. At the default `initial_u` of 0 both are
            the same. Masking is the default since no exploration is left in a state without a next step;
            it favours no episode's end here as long as that is only the goal.
    """

    kappa: Float[Array, ""]
    initial_u: Float[Array, ""]
    exploration_reward: ExplorationReward
    bootstrap: Literal["max", "policy"] = eqx.field(static=True)
    terminal_u: Literal["masked", "bootstrap"] = eqx.field(static=True)

    @property
    def exploration_weight(self) -> Float[Array, ""]:
        """See `Learner`: kappa."""
        return self.kappa

    def _empty(self, num_states: int, num_actions: int) -> Tables:
        q, u, counts = (
            self._table(value, num_states, num_actions)
            for value in (self.initial_q, self.initial_u, jnp.zeros_like(self.initial_q))
        )
        return Tables(q, u, counts)

    def act(
        self, key: Key[Array, ""], state: Tables, observation: Int[Array, ""], balance: Balance
    ) -> tuple[Int[Array, ""], Float[Array, ""]]:
        """See `Learner`."""
        q, u = _row(state.q, observation), _row(state.u, observation)
        action = best_action(key, q, u, self.kappa * balance.exploration, self.ties)
        return action, q[action]

    def observe(
        self,
        key: Key[Array, ""],
        state: Tables,
        experience: Experience,
        balance: Balance,
        slot: Int[Array, ""],
    ) -> Tables:
        """See `Learner`."""
        del slot
        bonus = _bonus(self.exploration_reward, state.counts, experience)
        q, u = _row(state.q, experience.next_observation), _row(state.u, experience.next_observation)
        if self.bootstrap == "policy":
            action = best_action(key, q, u, self.kappa * balance.exploration, self.ties)
            next_q, next_u = q[action], u[action]
        else:
            next_q, next_u = jnp.max(q), jnp.max(u)
        next_q = self._masked(next_q, experience.terminated)
        if self.terminal_u == "masked":
            next_u = self._masked(next_u, experience.terminated)
        return Tables(
            q=self._toward(state.q, experience, experience.reward, next_q, balance),
            u=self._toward(state.u, experience, bonus, next_u, balance),
            counts=_add(state.counts, experience, jnp.ones_like(bonus), balance),
        )


class AdditiveRewards(TabularLearner):
    """One table Q of r + xi r_e (5.1); acts by argmax Q.

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

    def _empty(self, num_states: int, num_actions: int) -> Tables:
        q, counts = (
            self._table(value, num_states, num_actions)
            for value in (self.initial_q, jnp.zeros_like(self.initial_q))
        )
        return Tables(q, None, counts)

    def observe(
        self,
        key: Key[Array, ""],
        state: Tables,
        experience: Experience,
        balance: Balance,
        slot: Int[Array, ""],
    ) -> Tables:
        """See `Learner`."""
        del key, slot
        bonus = _bonus(self.exploration_reward, state.counts, experience)
        reward = experience.reward + self.xi * balance.exploration * bonus
        next_q = self._masked(jnp.max(_row(state.q, experience.next_observation)), experience.terminated)
        return Tables(
            q=self._toward(state.q, experience, reward, next_q, balance),
            u=None,
            counts=_add(state.counts, experience, jnp.ones_like(bonus), balance),
        )


class EpsilonGreedy(TabularLearner):
    """One table Q of rewards; acts by argmax Q, but uniformly with probability epsilon.

    Attributes:
        epsilon: That probability.
    """

    epsilon: Float[Array, ""]

    @property
    def exploration_weight(self) -> Float[Array, ""]:
        """See `Learner`: epsilon."""
        return self.epsilon

    def _empty(self, num_states: int, num_actions: int) -> Tables:
        return Tables(self._table(self.initial_q, num_states, num_actions), None, None)

    def act(
        self, key: Key[Array, ""], state: Tables, observation: Int[Array, ""], balance: Balance
    ) -> tuple[Int[Array, ""], Float[Array, ""]]:
        """See `Learner`."""
        key_greedy, key_random = jax.random.split(key)
        best, _ = super().act(key_greedy, state, observation, balance)
        q = _row(state.q, observation)
        # One lot for both: below epsilon it is uniform there, and says which action.
        lot = jax.random.uniform(key_random, (), q.dtype)
        threshold = self.epsilon * balance.exploration
        explores = lot < threshold
        share = jnp.where(explores, lot / jnp.where(threshold > 0.0, threshold, 1.0), 0.0)
        drawn = jnp.minimum((share * q.shape[0]).astype(jnp.int32), q.shape[0] - 1)
        action = jnp.where(explores, drawn, best)
        return action, q[action]

    def observe(
        self,
        key: Key[Array, ""],
        state: Tables,
        experience: Experience,
        balance: Balance,
        slot: Int[Array, ""],
    ) -> Tables:
        """See `Learner`."""
        del key, slot
        next_q = self._masked(jnp.max(_row(state.q, experience.next_observation)), experience.terminated)
        return Tables(self._toward(state.q, experience, experience.reward, next_q, balance), None, None)


def _row(table: Float[Array, "S A"] | None, state: Int[Array, ""]) -> Float[Array, "A"]:
    """The row of a state; of the nearest one for a number outside."""
    assert table is not None
    return table.at[state].get(mode="clip")


def _add(
    table: Float[Array, "S A"] | None,
    experience: Experience,
    change: Float[Array, ""],
    balance: Balance,
) -> Float[Array, "S A"]:
    """Add to the entry of the step's pair, if the learner learns: a write of one number, not of a table."""
    assert table is not None
    change = jnp.where(balance.is_learning, change, 0.0)
    return table.at[experience.observation, experience.action].add(change, mode="drop")


def _bonus(
    exploration_reward: ExplorationReward, counts: Float[Array, "S A"] | None, experience: Experience
) -> Float[Array, ""]:
    count = _row(counts, experience.observation)[experience.action]
    return exploration_reward(count, _row(counts, experience.next_observation))
