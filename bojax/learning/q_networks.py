"""Q-learning with neural networks on a grid of actions (Mnih et al., Nature 518, 2015).

A transition is stored when it is observed. After every `train_every` steps, the networks take one step of
Adam on a uniform sample of all transitions of the run, with values of the next states from a slow copy of the
networks. `BootstrappedQ` and `RND` define the exploration.
"""

import abc
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, Key, PyTree
from typing_extensions import override

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Space
from bojax.learning.actions import grid_actions, nearest_action
from bojax.learning.base import Episode, ExplorationState, Learner, Transition
from bojax.learning.memory import Memory, emptied
from bojax.learning.networks import Network


class Batch(eqx.Module):
    """The transitions of a gradient step, as inputs and outputs of the networks."""

    x: Float[Array, "B I"]  # inputs of the states
    action: Int[Array, "B"]  # indices of the actions
    reward: Float[Array, "B"]
    next_x: Float[Array, "B I"]  # inputs of the next states
    continues: Float[Array, "B"]  # 1, or 0 where the next state is terminal
    index: Int[Array, "B"]  # positions of the transitions in the memory


class QNetworkState(eqx.Module):
    """The state of a learner with Q-networks."""

    observations: Space  # space of observations
    actions: Action
    trained: PyTree  # networks that are trained
    target: PyTree  # their slow copies
    fixed: PyTree  # random networks that never change
    optimiser: PyTree  # state of Adam
    memory: Memory  # all transitions of the run, with the indices of actions
    index: Int[Array, "B"]  # positions in the memory of the transitions of the next gradient step
    is_due: Bool[Array, ""]  # whether a transition was observed since the last gradient step
    extra: PyTree  # method-specific state


class QNetworkLearner(Learner):
    """A learner with networks on a grid of actions.

    A subclass defines its networks, their loss, its own state, and its policy.
    """

    # Measured with 10 heads: a core takes 6,100 steps/s with 8 lanes, and 4,300 with 32.
    lanes_on_cpu: ClassVar[int] = 8

    discount: Float[Array, ""]
    learning_rate: Float[Array, ""]
    target_rate: Float[Array, ""]
    actions_per_dimension: int = eqx.field(static=True)
    width: int = eqx.field(static=True)
    depth: int = eqx.field(static=True)
    batch_size: int = eqx.field(static=True)
    train_every: int = eqx.field(static=True)

    @abc.abstractmethod
    def networks(self, key: Key[Array, ""], num_inputs: int, num_actions: int) -> tuple[PyTree, PyTree]:
        """New networks: trained ones, and random ones that never change."""

    @abc.abstractmethod
    def initial_extra(self, key: Key[Array, ""]) -> PyTree:
        """Method-specific state at the beginning of a run."""

    @abc.abstractmethod
    def loss(self, trained: PyTree, state: QNetworkState, batch: Batch) -> Float[Array, ""]:
        """The loss whose gradient in `trained` is followed."""

    @abc.abstractmethod
    def extra_after(self, state: QNetworkState, next_x: Float[Array, "I"]) -> PyTree:
        """Method-specific state after observing next-state inputs `next_x`."""

    # The interface of a learner.

    @property
    @override
    def block(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Number of steps between two gradient steps, which are the delayed updates."""
        return self.train_every

    @override
    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> QNetworkState:
        key_networks, key_extra = jax.random.split(key)
        actions = grid_actions(self.actions_per_dimension, action_space)
        trained, fixed = self.networks(key_networks, observation_space.num_units, len(actions))
        # At least one row: an empty array cannot be spread over devices.
        number = jnp.zeros((), jnp.int32)
        memory = Memory.empty(max(1, capacity), observation_space.example, number, self.discount.dtype)
        return QNetworkState(
            observations=observation_space,
            actions=actions,
            trained=trained,
            target=trained,
            fixed=fixed,
            optimiser=self._adam.init(trained),
            memory=memory,
            index=jnp.zeros((self.batch_size,), jnp.int32),
            is_due=jnp.zeros((), bool),
            extra=self.initial_extra(key_extra),
        )

    @override
    def observe(
        self,
        key: Key[Array, ""],
        state: QNetworkState,
        transition: Transition,
        exploration: ExplorationState,
        step_in_block: Int[Array, ""],
    ) -> QNetworkState:
        """Store the transition, and draw the sample of the next gradient step."""
        learns = exploration.is_learning
        action = nearest_action(state.actions, transition.action)
        stored = eqx.tree_at(lambda t: t.action, transition, action)
        episode = Episode(jax.tree.map(lambda x: x[None], stored), jnp.ones((), jnp.int32))
        memory = state.memory.add(episode, learns)
        # The sample of the next gradient step is drawn here, as `flush` has no key; each step replaces the
        # last draw.
        index = jax.random.randint(key, state.index.shape, 0, jnp.maximum(memory.count, 1), jnp.int32)
        extra = self.extra_after(state, self.inputs(state, transition.next_observation))
        return replace(
            state,
            memory=memory,
            index=optax.tree.where(learns, index, state.index),
            is_due=state.is_due | learns,
            extra=optax.tree.where(learns, extra, state.extra),
        )

    @override
    def flush(self, state: QNetworkState) -> QNetworkState:
        """One gradient step, if a transition was observed since the last one."""
        # Computed in every lane, and selected where a transition was observed: the networks are small.
        gradient = jax.grad(self.loss)(state.trained, state, self.batch(state))
        with jax.numpy_dtype_promotion("standard"):  # optax raises a float to the power of an integer
            steps, optimiser = self._adam.update(gradient, state.optimiser)
        trained = optax.apply_updates(state.trained, steps)
        target = optax.incremental_update(trained, state.target, self.target_rate)
        after = optax.tree.where(
            state.is_due, (trained, target, optimiser), (state.trained, state.target, state.optimiser)
        )
        return eqx.tree_at(
            lambda s: (s.trained, s.target, s.optimiser, s.is_due),
            state,
            (*after, jnp.zeros_like(state.is_due)),
        )

    @override
    def policy_state(self, state: QNetworkState) -> QNetworkState:
        return eqx.tree_at(lambda s: s.memory, state, emptied(state.memory))

    # Common parts of the methods.

    def network(self, key: Key[Array, ""], num_inputs: int, num_outputs: int) -> Network:
        """A new network of the size of the settings, with the random weights of `equinox.nn.MLP`."""
        dtype = self.discount.dtype
        mlp = eqx.nn.MLP(num_inputs, num_outputs, self.width, self.depth, dtype=dtype, key=key)
        return Network(mlp.layers, jax.nn.relu)

    def inputs(self, state: QNetworkState, observation: Observation) -> Float[Array, "*N I"]:
        """Inputs of the networks: observations with bounds mapped to -1 and 1, or one-hot discrete states."""
        return state.observations.inputs(observation, self.discount.dtype)

    def batch(self, state: QNetworkState) -> Batch:
        """The transitions of the next gradient step."""
        memory, index = state.memory, state.index
        return Batch(
            x=self.inputs(state, memory.observations[index]),
            action=memory.actions[index],
            reward=memory.rewards[index],
            next_x=self.inputs(state, memory.next_observations[index]),
            continues=(~memory.terminated[index]).astype(memory.rewards.dtype),
            index=index,
        )

    @property
    def _adam(self) -> optax.GradientTransformation:
        return optax.adam(self.learning_rate)
