"""Random network distillation (Burda, Edwards, Storkey and Klimov, ICLR 2019) on Q-networks."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.envs.base import Action, Observation
from bojax.learning.actions import nearest_action
from bojax.learning.base import ExplorationState
from bojax.learning.networks import Network
from bojax.learning.policy import best_action
from bojax.learning.q_networks import Batch, QNetworkLearner, QNetworkState

Q, U = 0, 1  # rows of the outputs of the value network


class Normaliser(eqx.Module):
    """Running moments of the discounted sums of bonuses, by Welford's method."""

    total: Float[Array, ""]  # discounted sum of all bonuses so far
    count: Float[Array, ""]  # number of sums
    mean: Float[Array, ""]  # mean of the sums
    squares: Float[Array, ""]  # sum of squared differences from the mean

    def after(self, bonus: Float[Array, ""], discount: Float[Array, ""]) -> "Normaliser":
        """Update the running moments with one bonus."""
        total, count = discount * self.total + bonus, self.count + 1.0
        difference = total - self.mean
        mean = self.mean + difference / count
        return Normaliser(total, count, mean, self.squares + difference * (total - mean))

    @property
    def deviation(self) -> Float[Array, ""]:
        """Standard deviation of the sums; 1 until they differ."""
        variance = self.squares / jnp.maximum(self.count, 1.0)
        return jnp.where(variance > 0.0, jnp.sqrt(variance), 1.0)


class Networks(eqx.Module):
    """The networks that are trained."""

    values: Network  # Q and U of every action
    predictor: Network  # prediction of the outputs of a random network


class RND(QNetworkLearner):
    """Values Q of rewards and U of bonuses; acts by argmax Q + kappa U, or at random (epsilon-greedy).

    The bonus of a transition is the squared error with which a network, trained on the same samples as the
    values, predicts the outputs of a random network at s'. The bonus is small where states are often seen. As
    in the paper, it is divided by the running standard deviation of its discounted sums, and U is
    bootstrapped past the end of an episode. Bonuses are computed anew in every gradient step. The TD target
    of Q takes the maximum of Q at s', and the target of U the action argmax Q + kappa U.

    Deviations from the paper: Q-learning instead of PPO, and observations scaled by their declared bounds
    instead of running moments.

    Settings: `bojax.learning.settings.RND`.
    """

    kappa: Float[Array, ""]
    epsilon: Float[Array, ""]
    u_discount: Float[Array, ""]
    num_outputs: int = eqx.field(static=True)

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        return self.kappa

    @override
    def networks(self, key: Key[Array, ""], num_inputs: int, num_actions: int) -> tuple[Networks, Network]:
        keys = jax.random.split(key, 3)
        values = self.network(keys[0], num_inputs, 2 * num_actions)
        predictor = self.network(keys[1], num_inputs, self.num_outputs)
        return Networks(values, predictor), self.network(keys[2], num_inputs, self.num_outputs)

    @override
    def initial_extra(self, key: Key[Array, ""]) -> Normaliser:
        zero = jnp.zeros_like(self.discount)
        return Normaliser(zero, zero, zero, zero)

    @override
    def extra_after(self, state: QNetworkState, next_x: Float[Array, "I"]) -> Normaliser:
        return state.extra.after(self.prediction_error(state.trained, state.fixed, next_x), self.u_discount)

    @override
    def act(
        self,
        key: Key[Array, ""],
        state: QNetworkState,
        observation: Observation,
        exploration: ExplorationState,
    ) -> tuple[Action, Float[Array, ""]]:
        keys = jax.random.split(key, 3)
        values = self.q_and_u(state.trained, self.inputs(state, observation))
        best = best_action(keys[0], values[Q] + exploration.scale * self.kappa * values[U])
        is_random = jax.random.uniform(keys[1], (), values.dtype) < exploration.scale * self.epsilon
        random = jax.random.randint(keys[2], (), 0, len(state.actions), jnp.int32)
        action = jnp.where(is_random, random, best)
        return state.actions[action], values[Q, action]

    @override
    def loss(self, trained: Networks, state: QNetworkState, batch: Batch) -> Float[Array, ""]:
        """The squared TD errors of Q and U, and the error of the prediction, averaged over the batch."""
        values = jax.vmap(lambda x: self.q_and_u(trained, x))(batch.x)
        taken = jnp.take_along_axis(values, batch.action[:, None, None], axis=2)[:, :, 0]
        errors = taken - self.td_targets(state, batch)
        prediction = jax.vmap(lambda x: self.prediction_error(trained, state.fixed, x))(batch.next_x)
        return jnp.mean(0.5 * jnp.sum(errors**2, axis=1) + prediction)

    def td_targets(self, state: QNetworkState, batch: Batch) -> Float[Array, "B 2"]:
        """The TD targets of Q and U."""
        values = jax.vmap(lambda x: self.q_and_u(state.target, x))(batch.next_x)
        best = jnp.argmax(values[:, Q] + self.kappa * values[:, U], axis=1)
        next_u = jnp.take_along_axis(values[:, U], best[:, None], axis=1)[:, 0]
        q = batch.reward + self.discount * batch.continues * jnp.max(values[:, Q], axis=1)
        return jnp.stack([q, self.bonus(state, batch.next_x) + self.u_discount * next_u], axis=1)

    def bonus(self, state: QNetworkState, next_x: Float[Array, "B I"]) -> Float[Array, "B"]:
        """The normalised bonus of steps to states with inputs `next_x`."""
        errors = jax.vmap(lambda x: self.prediction_error(state.trained, state.fixed, x))(next_x)
        return errors / state.extra.deviation

    def prediction_error(self, trained: Networks, fixed: Network, x: Float[Array, "I"]) -> Float[Array, ""]:
        """The mean squared error of the predicted outputs of the random network."""
        return jnp.mean((trained.predictor(x) - fixed(x)) ** 2)

    def q_and_u(self, trained: Networks, x: Float[Array, "I"]) -> Float[Array, "2 A"]:
        """Q and U of every action."""
        return trained.values(x).reshape(2, -1)

    @override
    def values(
        self, state: QNetworkState, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        values = self.q_and_u(state.trained, self.inputs(state, observation))
        q, u = values[:, nearest_action(state.actions, action)]
        return q, u
