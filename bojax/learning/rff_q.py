"""Q-learning with linear features and an epsilon-greedy policy (thesis, Sections 5.6.4 and 5.7)."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Discrete, Space
from bojax.learning.actions import even_actions, uniform_actions
from bojax.learning.base import ExplorationState, Learner, Transition
from bojax.learning.features import FeatureSpec, StateActionFeatures
from bojax.learning.policy import random_argmax
from bojax.numerics.linalg import matmul


class RFFQState(eqx.Module):
    """The state of `RFFQ`."""

    features: StateActionFeatures  # feature map phi of this run
    weights: Float[Array, "M"]  # weights of Q
    candidates: Action  # actions of the same number and shape as the candidates of the maximum, `[J, ...]`


class RFFQ(Learner):
    """Semi-gradient Q-learning: w += rate (r + gamma max_a' w'phi(s', a') - w'phi(s, a)) phi(s, a).

    The maximum is over fresh uniform draws, or over all actions of a discrete space.

    Settings: `bojax.learning.settings.RFFQ`.
    """

    # Measured with 300 features: a core takes 18,000 steps/s with 8 lanes, and 15,000 with 32.
    lanes_on_cpu: ClassVar[int] = 8
    # A step on an H200 takes 31 us with 200 lanes and 48 with 1,000: its fixed cost is that of some 1,200.
    narrowest: ClassVar[int] = 400

    features: FeatureSpec
    discount: Float[Array, ""]
    learning_rate: Float[Array, ""]
    epsilon: Float[Array, ""]
    initial_weight: Float[Array, ""]
    num_actions: int = eqx.field(static=True)
    normalise: bool = eqx.field(static=True)
    block: int = eqx.field(static=True)

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        return self.epsilon

    @override
    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        self.features.check_spaces(observation_space, action_space)

    @override
    def fitted(self, observation_space: Space, action_space: Space) -> "RFFQ":
        features = self.features.fitted(observation_space, action_space, self.discount.dtype)
        return eqx.tree_at(lambda learner: learner.features, self, features)

    @override
    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> RFFQState:
        key_features, key_weights, key_actions = jax.random.split(key, 3)
        dtype = self.discount.dtype
        features = self.features.draw(key_features, observation_space, action_space, dtype)
        weights = self.initial_weight * jax.random.normal(key_weights, (features.num_features,), dtype)
        return RFFQState(features, weights, even_actions(key_actions, self.num_actions, action_space))

    @override
    def act(
        self, key: Key[Array, ""], state: RFFQState, observation: Observation, exploration: ExplorationState
    ) -> tuple[Action, Float[Array, ""]]:
        """A random candidate with probability epsilon, else the best candidate."""
        space, candidates = state.features.actions, state.candidates
        is_finite = isinstance(space, Discrete)
        # All from one call, which is a kernel on a GPU.
        draws = jax.random.uniform(key, (2 + (0 if is_finite else candidates.size),), self.epsilon.dtype)
        if not is_finite:
            candidates = space.from_unit(draws[2:].reshape(candidates.shape))
        q = self._values(state, observation, candidates)
        # Fresh draws are in random order: the first of several best ones is as good as any.
        best = random_argmax(draws[1], q) if is_finite else jnp.argmax(q).astype(jnp.int32)
        is_random = draws[0] < exploration.scale * self.epsilon
        place = jnp.where(is_random, (draws[1] * len(candidates)).astype(jnp.int32), best)
        return candidates[place], q[place]

    @override
    def observe(
        self,
        key: Key[Array, ""],
        state: RFFQState,
        transition: Transition,
        exploration: ExplorationState,
        step_in_block: Int[Array, ""],
    ) -> RFFQState:
        candidates = uniform_actions(key, state.candidates, state.features.actions)
        best = jnp.max(self._values(state, transition.next_observation, candidates))
        target = transition.reward + self.discount * jnp.where(transition.terminated, 0.0, best)
        phi = state.features(transition.observation, transition.action)
        rate = self.learning_rate / jnp.sum(phi * phi) if self.normalise else self.learning_rate
        step = rate * (target - matmul(phi, state.weights))
        weights = state.weights + jnp.where(exploration.is_learning, step, 0.0) * phi
        return eqx.tree_at(lambda s: s.weights, state, weights)

    @override
    def values(
        self, state: RFFQState, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        q = self._values(state, observation, action[None])[0]
        return q, jnp.zeros_like(q)

    def _values(self, state: RFFQState, observation: Observation, actions: Action) -> Float[Array, "J"]:
        return state.features.values(state.weights, observation, actions)
