"""Bootstrapped Q-networks with randomised priors (Osband et al., NeurIPS 2016 and 2018)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.envs.base import Action, Observation
from bojax.learning.actions import nearest_action
from bojax.learning.base import Episode, ExplorationState
from bojax.learning.networks import Network
from bojax.learning.q_networks import Batch, QNetworkLearner, QNetworkState


class Bootstrap(eqx.Module):
    """The state of `BootstrappedQ` besides its networks."""

    head: Int[Array, ""]  # head that acts in this episode
    seed: Int[Array, ""]  # seed of the masks


class BootstrappedQ(QNetworkLearner):
    """Thompson sampling with K Q-networks: one, drawn at random, acts for a whole episode.

    Head k is Q_k = f_k + `prior_scale` p_k, where the prior p_k is a random network that never changes. It
    learns from the transitions of its mask, each with probability `mask_probability`, by Q-learning with a
    slow copy of f_k (Osband, Aslanides and Cassirer, 2018, Section 3). With exploration at scale c, actions
    maximise mean + c (Q_k - mean), where the mean is over the heads: in a test, the mean.

    Deviations from the paper of 2016: heads do not share layers, tests use the mean instead of a vote, and
    targets take the maximum of the slow copy instead of double Q-learning.

    Settings: `bojax.learning.settings.BootstrappedQ`.
    """

    prior_scale: Float[Array, ""]
    mask_probability: Float[Array, ""]
    num_heads: int = eqx.field(static=True)

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        """Weight of the acting head against the mean of all heads."""
        return jnp.ones_like(self.discount)

    @override
    def networks(self, key: Key[Array, ""], num_inputs: int, num_actions: int) -> tuple[Network, Network]:
        """K networks f_k and their priors p_k, in stacked arrays."""

        def heads(key: Key[Array, ""]) -> Network:
            keys = jax.random.split(key, self.num_heads)
            return jax.vmap(lambda key: self.network(key, num_inputs, num_actions))(keys)

        key_networks, key_priors = jax.random.split(key)
        return heads(key_networks), heads(key_priors)

    @override
    def initial_extra(self, key: Key[Array, ""]) -> Bootstrap:
        key_head, key_seed = jax.random.split(key)
        most = jnp.iinfo(jnp.int32).max
        return Bootstrap(self._any_head(key_head), jax.random.randint(key_seed, (), 0, most, jnp.int32))

    @override
    def extra_after(self, state: QNetworkState, next_x: Float[Array, "I"]) -> Bootstrap:
        return state.extra

    @override
    def act(
        self,
        key: Key[Array, ""],
        state: QNetworkState,
        observation: Observation,
        exploration: ExplorationState,
    ) -> tuple[Action, Float[Array, ""]]:
        q = self.q(state.trained, state.fixed, self.inputs(state, observation))
        mean = jnp.mean(q, axis=0)
        scores = mean + exploration.scale * (q[state.extra.head] - mean)
        best = jnp.argmax(scores)
        return state.actions[best], scores[best]

    @property
    @override
    def learns_from_episodes(self) -> bool:
        return type(self).end_episode is not BootstrappedQ.end_episode

    @override
    def end_episode(
        self, key: Key[Array, ""], state: QNetworkState, episode: Episode, exploration: ExplorationState
    ) -> QNetworkState:
        """Draw the head that acts in the next episode."""
        head = jnp.where(exploration.is_learning, self._any_head(key), state.extra.head)
        return eqx.tree_at(lambda s: s.extra.head, state, head)

    @override
    def loss(self, trained: Network, state: QNetworkState, batch: Batch) -> Float[Array, ""]:
        """The squared TD errors, summed over heads and averaged over the batch."""
        targets = self.td_targets(state, batch)
        q = jax.vmap(lambda x: self.q(trained, state.fixed, x))(batch.x)
        taken = jnp.take_along_axis(q, batch.action[:, None, None], axis=2)[:, :, 0]
        errors = jnp.where(self.masks(state, batch.index), taken - targets, 0.0)
        return 0.5 * jnp.sum(jnp.mean(errors**2, axis=0))

    def td_targets(self, state: QNetworkState, batch: Batch) -> Float[Array, "B K"]:
        """The TD target r + gamma max_a' Q_k(s', a') of every head; r alone where s' is terminal."""
        q = jax.vmap(lambda x: self.q(state.target, state.fixed, x))(batch.next_x)
        return batch.reward[:, None] + self.discount * batch.continues[:, None] * jnp.max(q, axis=2)

    def masks(self, state: QNetworkState, index: Int[Array, "B"]) -> Bool[Array, "B K"]:
        """Which heads learn from the given transitions; the same in every gradient step."""
        # Not stored: drawn again from the seed and the position in the memory, a transition has the same mask
        # every time.
        key = jax.random.key(state.extra.seed)
        shape, dtype = (self.num_heads,), self.discount.dtype
        draws = jax.vmap(lambda i: jax.random.uniform(jax.random.fold_in(key, i), shape, dtype))(index)
        return draws < self.mask_probability

    def q(self, networks: Network, priors: Network, x: Float[Array, "I"]) -> Float[Array, "K A"]:
        """Q of every head and action."""
        return jax.vmap(lambda f, p: f(x) + self.prior_scale * p(x))(networks, priors)

    @override
    def values(
        self, state: QNetworkState, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Mean and standard deviation of Q over the heads."""
        q = self.q(state.trained, state.fixed, self.inputs(state, observation))
        q = q[:, nearest_action(state.actions, action)]
        return jnp.mean(q), jnp.std(q)

    def _any_head(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return jax.random.randint(key, (), 0, self.num_heads, jnp.int32)
