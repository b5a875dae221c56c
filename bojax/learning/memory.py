"""A memory of all transitions of a run, as states and actions; features are recomputed where needed."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.envs.base import Action, Observation
from bojax.learning.base import Episode
from bojax.numerics.lanes import batched_together, largest_in_lanes

T = TypeVar("T")  # A tree of arrays with one row for each transition, and of counts


class Memory(eqx.Module):
    """Up to C transitions (s, a, r, s'), in the order of their observation."""

    observations: Observation  # observations of s, `[C, ...]`
    actions: Action  # actions a, `[C, ...]`
    rewards: Float[Array, "C"]  # rewards r
    next_observations: Observation  # observations of s', `[C, ...]`
    terminated: Bool[Array, "C"]  # whether s' is terminal
    count: Int[Array, ""]  # number of transitions; later rows are zero

    @classmethod
    def empty(cls, capacity: int, observation: Observation, action: Action, dtype: jnp.dtype) -> "Memory":
        """An empty memory for observations and actions of the given shapes."""

        def zeros(example: Array) -> Array:
            return jnp.zeros((capacity, *example.shape), example.dtype)

        return cls(
            observations=zeros(observation),
            actions=zeros(action),
            rewards=jnp.zeros((capacity,), dtype),
            next_observations=zeros(observation),
            terminated=jnp.zeros((capacity,), bool),
            count=jnp.zeros((), jnp.int32),
        )

    def add(self, episode: Episode, is_kept: Bool[Array, ""]) -> "Memory":
        """The memory with an episode appended if `is_kept`; transitions beyond the capacity are dropped."""
        # Padding rows, and all rows of an episode that is not kept, get a place past the end, and their
        # writes are dropped: a select between the old and the new memory would copy it whole.
        new = episode.transitions
        number = jnp.arange(len(new.reward), dtype=jnp.int32)
        capacity = len(self.rewards)
        place = jnp.where((number < episode.length) & is_kept, self.count + number, capacity)

        def put(stored: Array, rows: Array) -> Array:
            return stored.at[place].set(rows.astype(stored.dtype), mode="drop")

        return Memory(
            observations=put(self.observations, new.observation),
            actions=put(self.actions, new.action),
            rewards=put(self.rewards, new.reward),
            next_observations=put(self.next_observations, new.next_observation),
            terminated=put(self.terminated, new.terminated),
            count=jnp.minimum(self.count + jnp.where(is_kept, episode.length, 0), capacity),
        )

    def fold(self, function, start, block: int, *, first: int = 0, end: int | None = None):
        """Fold a function over the transitions, or over those from `first` up to `end`, a block at a time.

        Blocks that are empty in every lane are skipped.

        Args:
            function: `(carry, rows, index, is_valid) -> carry`, where `rows` is a `Memory` of `block`
                transitions, `index` their positions, and `is_valid` marks the rows to count. The other rows
                are zero or were part of an earlier block.
            start: Initial carry.
            block: Largest number of transitions in a block.
            first: Position of the first transition.
            end: Position after the last transition; the capacity by default.
        """
        end = len(self.rewards) if end is None else end
        if end <= first:
            return start
        block = min(block, end - first)

        def visit(number, carry):
            # The last block is moved back so that it ends at `end`; rows that an earlier block has counted
            # are masked.
            begin = first + number * block
            place = jnp.minimum(begin, end - block)
            index = place + jnp.arange(block, dtype=jnp.int32)
            rows = jax.tree.map(
                lambda stored: jax.lax.dynamic_slice_in_dim(stored, place, block) if stored.ndim else stored,
                self,
            )
            is_valid = (index >= begin) & (index < self.count)
            return function(carry, rows, index, is_valid)

        # As many blocks as the fullest lane needs: one trip count for all keeps the loop's predicate
        # unbatched.
        number = jnp.clip(largest_in_lanes(self.count), first, end) - first
        start, _ = batched_together((start, self.count))
        return jax.lax.fori_loop(0, (number + block - 1) // block, visit, start)


class StoredRewards(eqx.Module):
    """The exploration rewards of up to C transitions, as they were when the transitions were observed."""

    values: Float[Array, "C"]  # exploration rewards, in the order of `Memory`; later ones are zero
    count: Int[Array, ""]  # number of transitions

    @classmethod
    def empty(cls, capacity: int, dtype: jnp.dtype) -> "StoredRewards":
        """No rewards, and room for `capacity`."""
        return cls(jnp.zeros((capacity,), dtype), jnp.zeros((), jnp.int32))

    def add(self, reward: Float[Array, ""], is_kept: Bool[Array, ""]) -> "StoredRewards":
        """The rewards with one appended if `is_kept`; rewards beyond the capacity are dropped."""
        capacity = len(self.values)
        place = jnp.where(is_kept, self.count, capacity)
        values = self.values.at[place].set(reward.astype(self.values.dtype), mode="drop")
        return StoredRewards(values, jnp.minimum(self.count + is_kept.astype(jnp.int32), capacity))


def emptied(memory: T) -> T:
    """A memory, or a tree of memories, with room for one transition and none stored."""
    return jax.tree.map(lambda rows: jnp.zeros_like(rows[:1] if rows.ndim else rows), memory)
