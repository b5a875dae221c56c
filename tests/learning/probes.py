"""Small environments whose values are known by hand, and the exploration of an episode."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from bojax.envs.base import TimeStep
from bojax.envs.spaces import Discrete
from bojax.envs.tabular import TabularEnv
from bojax.learning.base import ExplorationState


def exploring(scale=1.0, is_learning=True):
    """The exploration of an episode, by default that of training without a schedule."""
    return ExplorationState(jnp.asarray(scale, jnp.float64), jnp.asarray(is_learning))


class Bandit(TabularEnv):
    """One state; each of two arms ends the episode and pays its reward."""

    rewards: Float[Array, "2"]
    max_steps: ClassVar[int] = 1
    num_actions: ClassVar[int] = 2
    num_branches: ClassVar[int] = 1

    @property
    def observation_space(self):
        return Discrete(1)

    def reset(self, key):
        return jnp.int32(0)

    def probabilities(self, state, action):
        return jnp.ones((1,), self.rewards.dtype)

    def outcome(self, state, action, branch):
        true = jnp.ones((), bool)
        return TimeStep(jnp.int32(0), self.rewards[action], true, ~true, self.rewards[action] > 0)


class Loop(TabularEnv):
    """Two states in turn, one action; the second state pays 1, and ends the episode if it is absorbing.

    Attributes:
        absorbs: Whether the way from the second state ends the episode; otherwise the time limit does.
        reward: What the second state pays.
    """

    reward: Float[Array, ""]
    absorbs: bool = eqx.field(static=True)
    max_steps: int = eqx.field(static=True, default=2)
    num_actions: ClassVar[int] = 1
    num_branches: ClassVar[int] = 1

    @property
    def observation_space(self):
        return Discrete(2)

    def reset(self, key):
        return jnp.int32(0)

    def probabilities(self, state, action):
        return jnp.ones((1,), self.reward.dtype)

    def outcome(self, state, action, branch):
        is_second = state == 1
        return TimeStep(
            observation=1 - state,
            reward=jnp.where(is_second, self.reward, jnp.zeros_like(self.reward)),
            terminated=is_second & self.absorbs,
            truncated=jnp.zeros((), bool),
            success=is_second,
        )
