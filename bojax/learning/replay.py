"""A pool of the latest transitions of a run, from which a model of the dynamics is learned."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.base import Action, Observation
from bojax.learning.memory import Memory


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
        # `randint` with a bound that is not constant takes seconds to compile.
        draws = jax.random.uniform(key, (number,), jnp.float32)
        rows = (draws * self.size.astype(jnp.float32)).astype(jnp.int32)
        return jnp.clip(rows, 0, jnp.maximum(self.size - 1, 0))

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
