"""A batch of whole episodes of one policy, from which a policy gradient is estimated."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from bojax.envs.base import Action, Observation
from bojax.learning.base import Episode
from bojax.learning.memory import Memory


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
