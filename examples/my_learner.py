"""A learner of my own: Q-learning on a table, with a bonus for what was rarely done."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bojax.learning.base import Learner
from bojax.learning.policy import best_action


class Table(eqx.Module):
    """What it knows of every state and action, `[S, A]`: expected return, and number of visits."""

    q: Float[Array, "S A"]
    visits: Float[Array, "S A"]


class CountBonus(Learner):
    """Acts by argmax Q + weight / sqrt(1 + visits).

    Every array field is a setting that can be swept; `eqx.field(static=True)` marks what fixes shapes.
    """

    learning_rate: Float[Array, ""]
    discount: Float[Array, ""]  # of rewards, per step
    weight: Float[Array, ""]  # of the bonus
    block: int = eqx.field(static=True, default=16)  # steps between two looks at whether an episode is over

    @property
    def exploration_weight(self):
        """What a exploration of 1 stands for: the column `kappa` of the results."""
        return self.weight

    def init(self, key, observation_space, action_space, capacity):
        """Nothing is known yet."""
        zeros = jnp.zeros((observation_space.num, action_space.num), self.weight.dtype)
        return Table(zeros, zeros)

    def act(self, key, state, observation, exploration):
        """The best action, and the return that is expected of it; a test has a exploration of 0."""
        bonus = jax.lax.rsqrt(1.0 + state.visits[observation])
        action = best_action(key, state.q[observation], bonus, exploration.scale * self.weight)
        return action, state.q[observation, action]

    def observe(self, key, state, transition, exploration, slot):
        """Q-learning; an absorbing state is worth nothing, a time limit is none."""
        place = transition.observation, transition.action
        best = jnp.max(state.q[transition.next_observation])
        target = transition.reward + self.discount * jnp.where(transition.terminated, 0.0, best)
        rate = jnp.where(exploration.is_learning, self.learning_rate, 0.0)
        q = state.q.at[place].add(rate * (target - state.q[place]))
        return Table(q, state.visits.at[place].add(exploration.is_learning.astype(q.dtype)))

    def values(self, state, observation, action):
        """Q, and the bonus in the place of U, for maps."""
        return state.q[observation, action], jax.lax.rsqrt(1.0 + state.visits[observation, action])
