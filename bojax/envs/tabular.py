"""Environments with numbered states and actions whose every transition can be enumerated."""

import abc
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.envs.base import Env, TimeStep
from bojax.envs.spaces import Discrete


class TabularEnv(Env):
    """A finite Markov decision process; every action has a few branches with given probabilities.

    A subclass defines the probability and the outcome of each branch. `step` draws a branch; `transitions`
    lists all branches, for exact solutions by dynamic programming. The observation is the state itself.
    """

    num_actions: ClassVar[int]  # number of actions
    num_branches: ClassVar[int]  # number of branches of every action, K

    @property
    @abc.abstractmethod
    @override
    def observation_space(self) -> Discrete:
        """The states, numbered from 0."""

    @property
    @override
    def action_space(self) -> Discrete:
        return Discrete(self.num_actions)

    @abc.abstractmethod
    def probabilities(self, state: Int[Array, ""], action: Int[Array, ""]) -> Float[Array, "K"]:
        """Probability of each branch; they sum to 1."""

    @abc.abstractmethod
    def outcome(self, state: Int[Array, ""], action: Int[Array, ""], branch: Int[Array, ""]) -> TimeStep:
        """The time step that a branch leads to."""

    @override
    def step(
        self, key: Key[Array, ""], state: Int[Array, ""], action: Int[Array, ""]
    ) -> tuple[Int[Array, ""], TimeStep]:
        action = jnp.clip(action, 0, self.action_space.num - 1)
        branch = jnp.zeros((), jnp.int32)
        if self.num_branches > 1:
            probabilities = self.probabilities(state, action)
            draw = jax.random.uniform(key, (), probabilities.dtype)
            # The last cumulative probability is not compared, since rounding may put it below the draw.
            branch = jnp.sum(draw >= jnp.cumsum(probabilities)[:-1], dtype=jnp.int32)
        transition = self.outcome(state, action, branch)
        return transition.observation, transition

    def transitions(self) -> tuple[Float[Array, "S A K"], TimeStep]:
        """Probability and outcome of every branch of every action in every state, `[S, A, K]`."""
        nums = self.observation_space.num, self.action_space.num, self.num_branches
        states, actions, branches = (jnp.arange(num, dtype=jnp.int32) for num in nums)

        def of_pair(state, action):
            outcomes = jax.vmap(lambda branch: self.outcome(state, action, branch))(branches)
            return self.probabilities(state, action), outcomes

        return jax.vmap(lambda state: jax.vmap(lambda action: of_pair(state, action))(actions))(states)


def moved_to(state: Int[Array, ""], reward: Float[Array, ""], is_goal: Bool[Array, ""]) -> TimeStep:
    """The time step to a state, which ends the episode with a success if the state is the goal."""
    return TimeStep(state, reward, terminated=is_goal, truncated=jnp.zeros((), bool), success=is_goal)
