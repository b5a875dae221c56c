"""The transitions of a run, kept as states and actions: features are computed again where they are needed."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.envs.base import Action, Observation
from bojax.learning.base import Episode
from bojax.numerics.lanes import largest_in_lanes


class Memory(eqx.Module):
    """Up to C transitions, in the order in which they were made.

    Attributes:
        observations: What was seen, `[C, ...]`.
        actions: What was done.
        rewards: What came of it.
        next_observations: What was seen then.
        terminated: Whether that state is absorbing.
        count: Number of transitions; later rows are zero.
    """

    observations: Observation
    actions: Action
    rewards: Float[Array, "C"]
    next_observations: Observation
    terminated: Bool[Array, "C"]
    count: Int[Array, ""]

    @classmethod
    def empty(cls, capacity: int, observation: Observation, action: Action, dtype: jnp.dtype) -> "Memory":
        """Room for transitions with observations and actions of these shapes."""

        def room(example: Array) -> Array:
            return jnp.zeros((capacity, *example.shape), example.dtype)

        return cls(
            observations=room(observation),
            actions=room(action),
            rewards=jnp.zeros((capacity,), dtype),
            next_observations=room(observation),
            terminated=jnp.zeros((capacity,), bool),
            count=jnp.zeros((), jnp.int32),
        )

    def add(self, episode: Episode, is_kept: Bool[Array, ""]) -> "Memory":
        """The memory with an episode at its end, if it is to be kept; what does not fit is left out."""
        steps = episode.steps
        number = jnp.arange(len(steps.reward), dtype=jnp.int32)
        capacity = len(self.rewards)
        place = jnp.where((number < episode.length) & is_kept, self.count + number, capacity)

        def put(room: Array, rows: Array) -> Array:
            return room.at[place].set(rows.astype(room.dtype), mode="drop")

        return Memory(
            observations=put(self.observations, steps.observation),
            actions=put(self.actions, steps.action),
            rewards=put(self.rewards, steps.reward),
            next_observations=put(self.next_observations, steps.next_observation),
            terminated=put(self.terminated, steps.terminated),
            count=jnp.minimum(self.count + jnp.where(is_kept, episode.length, 0), capacity),
        )

    def fold(self, function, start, block: int):
        """Fold a function over the transitions, some of them at a time.

        Only blocks that hold a transition of some lane are visited.

        Args:
            function: `(carry, rows, index, is_there) -> carry`, with rows a `Memory` of `block` transitions,
                their indices, and which of them are there; the others are zero, or repeat earlier ones.
            start: The first carry.
            block: Most transitions at a time.
        """
        capacity = len(self.rewards)
        if not capacity:
            return start
        block = min(block, capacity)

        def visit(number, carry):
            first = jnp.minimum(number * block, capacity - block)
            index = first + jnp.arange(block, dtype=jnp.int32)
            rows = jax.tree.map(
                lambda room: jax.lax.dynamic_slice_in_dim(room, first, block) if room.ndim else room, self
            )
            is_there = (index >= number * block) & (index < self.count)
            return function(carry, rows, index, is_there)

        num_blocks = (largest_in_lanes(self.count) + block - 1) // block
        return jax.lax.fori_loop(0, num_blocks, visit, start)
