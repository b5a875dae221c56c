"""Memories of transitions as states and actions: all of a run, the latest, and episodes of one policy."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.base import Action, Observation
from bojax.learning.base import Episode
from bojax.numerics.lanes import batched_together, largest_in_lanes
from bojax.numerics.simulation_keys import random_index

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

        The function is `(carry, rows, index, is_valid) -> carry`, where `rows` is a `Memory` of `block`
        transitions, `index` their positions, and `is_valid` marks the rows to count. The other rows are zero
        or were part of an earlier block.
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


class EpisodeBatch(eqx.Module):
    """Up to C transitions of successive episodes."""

    memory: Memory  # the transitions in order. Rows from its count on are those of an earlier batch
    steps: Int[Array, "C"]  # number of steps before the transition in its episode

    @classmethod
    def empty(
        cls, capacity: int, observation: Observation, action: Action, dtype: jnp.dtype
    ) -> "EpisodeBatch":
        """An empty batch for observations and actions of the given shapes."""
        return cls(Memory.empty(capacity, observation, action, dtype), jnp.zeros((capacity,), jnp.int32))

    @property
    def is_valid(self) -> Bool[Array, "C"]:
        """Which rows hold a transition of the batch."""
        return jnp.arange(len(self.steps), dtype=jnp.int32) < self.memory.count

    @property
    def is_last(self) -> Bool[Array, "C"]:
        """Which transitions are the last of their episode; true for invalid rows."""
        # A row is the last of its episode unless the next one is valid and not the first step of another.
        follows = jnp.append(self.steps[1:] > 0, False) & jnp.append(self.is_valid[1:], False)
        return ~follows

    def add(self, episode: Episode, longest: int, is_kept: Bool[Array, ""]) -> "EpisodeBatch":
        """The batch with the first `longest` steps of an episode appended if `is_kept`."""
        episode = Episode(episode.transitions, jnp.minimum(episode.length, longest))
        capacity = len(self.steps)
        number = jnp.arange(len(episode.transitions.reward), dtype=jnp.int32)
        place = jnp.where((number < episode.length) & is_kept, self.memory.count + number, capacity)
        steps = self.steps.at[place].set(number, mode="drop")
        return EpisodeBatch(self.memory.add(episode, is_kept), steps)

    def emptied(self, is_emptied: Bool[Array, ""]) -> "EpisodeBatch":
        """The batch, without its transitions if `is_emptied`."""
        count = jnp.where(is_emptied, 0, self.memory.count)
        return eqx.tree_at(lambda batch: batch.memory.count, self, count)


class ReplayPool(eqx.Module):
    """The latest C transitions (s, a, s'). A row is a whole transition, so that no row spans two episodes."""

    observations: Observation  # observations of s, `[C, ...]`
    actions: Action  # actions a, `[C, ...]`
    next_observations: Observation  # observations of s', `[C, ...]`
    # Number of transitions added so far; once the pool is full, a new one replaces the oldest
    added: Int[Array, ""]

    @classmethod
    def empty(cls, capacity: int, observation: Observation, action: Action) -> "ReplayPool":
        """An empty pool for observations and actions of the given shapes."""
        observations = jnp.zeros((capacity, *observation.shape), observation.dtype)
        actions = jnp.zeros((capacity, *action.shape), action.dtype)
        return cls(observations, actions, observations, jnp.zeros((), jnp.int32))

    @property
    def capacity(self) -> int:
        """Largest number of transitions, C."""
        return len(self.observations)

    @property
    def size(self) -> Int[Array, ""]:
        """Number of transitions."""
        return jnp.minimum(self.added, self.capacity)

    @property
    def is_filled(self) -> Bool[Array, "C"]:
        """Which rows hold a transition."""
        return jnp.arange(self.capacity, dtype=jnp.int32) < self.added

    def draw(self, key: Key[Array, ""], number: int) -> Int[Array, "N"]:
        """Rows of `number` transitions, drawn uniformly with replacement; row 0 if the pool is empty."""
        return random_index(key, self.size, (number,))

    def add(self, memory: Memory, is_kept: Bool[Array, ""]) -> "ReplayPool":
        """The pool with the transitions of a memory appended if `is_kept`."""
        number = jnp.arange(len(memory.rewards), dtype=jnp.int32)
        # Of more transitions than the pool can hold, the last ones are kept.
        is_stored = is_kept & (number < memory.count) & (number >= memory.count - self.capacity)
        place = jnp.where(is_stored, (self.added + number) % self.capacity, self.capacity)

        def put(stored: Array, rows: Array) -> Array:
            return stored.at[place].set(rows, mode="drop")

        return ReplayPool(
            observations=put(self.observations, memory.observations),
            actions=put(self.actions, memory.actions),
            next_observations=put(self.next_observations, memory.next_observations),
            added=self.added + jnp.where(is_kept, memory.count, 0),
        )


class Standardisation(eqx.Module):
    """Mean and standard deviation of the rows of a table."""

    mean: Float[Array, "D"]  # mean of each column
    deviation: Float[Array, "D"]  # standard deviation of each column

    @classmethod
    def of(cls, rows: Float[Array, "N D"], is_valid: Bool[Array, "N"]) -> "Standardisation":
        """The moments of the valid rows; 0 if there are none."""
        weights = is_valid.astype(rows.dtype)[:, None]
        number = jnp.maximum(jnp.sum(weights), 1.0)
        mean = jnp.sum(weights * rows, axis=0) / number
        return cls(mean, jnp.sqrt(jnp.sum(weights * (rows - mean[None]) ** 2, axis=0) / number))

    def __call__(self, rows: Float[Array, "N D"], least: float) -> Float[Array, "N D"]:
        """Rows minus the mean, divided by the deviation plus `least`."""
        return (rows - self.mean[None]) / (self.deviation[None] + least)
