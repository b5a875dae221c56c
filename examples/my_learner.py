"""A learner of my own: tabular Q-learning with a bonus for rarely taken actions."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bojax.learning.base import Learner
from bojax.learning.policy import best_action


class Table(eqx.Module):
    """The state of the learner: expected return and number of visits of every state and action."""

    q: Float[Array, "S A"]
    visits: Float[Array, "S A"]


class CountBonus(Learner):
    """Acts by argmax Q + weight / sqrt(1 + visits).

    Every array field is a setting that can be swept; `eqx.field(static=True)` marks what fixes shapes.
    """

    learning_rate: Float[Array, ""]
    discount: Float[Array, ""]  # of rewards, per step
    weight: Float[Array, ""]  # of the bonus
    block: int = eqx.field(static=True, default=16)  # steps between two checks for the end of an episode

    @property
    def exploration_weight(self):
        """Weight of exploration at scale 1, for the column `kappa` of the results."""
        return self.weight

    def init(self, key, observation_space, action_space, capacity):
        """A learner that has observed nothing."""
        zeros = jnp.zeros((observation_space.num, action_space.num), self.weight.dtype)
        return Table(zeros, zeros)

    def act(self, key, state, observation, exploration):
        """The best action, and the return expected of it; a test has the scale 0."""
        bonus = jax.lax.rsqrt(1.0 + state.visits[observation])
        action = best_action(key, state.q[observation] + exploration.scale * self.weight * bonus)
        return action, state.q[observation, action]

    def observe(self, key, state, transition, exploration, step_in_block):
        """Q-learning; the value of a terminal state is 0, a time limit is not terminal."""
        place = transition.observation, transition.action
        best = jnp.max(state.q[transition.next_observation])
        target = transition.reward + self.discount * jnp.where(transition.terminated, 0.0, best)
        rate = jnp.where(exploration.is_learning, self.learning_rate, 0.0)
        q = state.q.at[place].add(rate * (target - state.q[place]))
        return Table(q, state.visits.at[place].add(exploration.is_learning.astype(q.dtype)))

    def values(self, state, observation, action):
        """Q, and the bonus in place of U, for maps."""
        return state.q[observation, action], jax.lax.rsqrt(1.0 + state.visits[observation, action])
