"""Uniformly random actions, the baseline of exploration."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Space
from bojax.learning.base import ExplorationState, Learner


class RandomActions(Learner):
    """Takes uniformly random actions and learns nothing; `discount` has no effect.

    The state is the action space.

    Settings: `bojax.learning.settings.RandomActions`.
    """

    discount: Float[Array, ""]
    block: int = eqx.field(static=True)

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        """1: all actions are exploration."""
        return jnp.ones_like(self.discount)

    @override
    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> Space:
        return action_space

    @override
    def act(
        self, key: Key[Array, ""], state: Space, observation: Observation, exploration: ExplorationState
    ) -> tuple[Action, Float[Array, ""]]:
        """A uniform draw from the action space, in tests as in training; the expected return is 0."""
        return state.sample(key), jnp.zeros_like(exploration.scale)

    @override
    def values(
        self, state: Space, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        zero = jnp.zeros_like(self.discount)
        return zero, zero
