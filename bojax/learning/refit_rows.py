"""The transitions that a refit of EMU-Q visits, and their features."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from bojax.learning.emu_q_model import EMUQState
from bojax.learning.memory import Memory, T

# 8 MB a run for 500 features in float32. On a CPU, which stores the features of one run of a batch at a time,
# refits of the reacher with 2,600 to 4,600 transitions take two thirds of their time with 2,048. With 8,192,
# filling the arrays with zeros takes longer than a short refit.
NUM_STORED, NUM_STORED_ON_CPU = 2048, 4096
"""Largest number of transitions whose phi(s, a) and x(s') are stored during a refit: the first ones of a run.

Of x(s') alone, twice as many are stored.
"""

# The last block is padded. Blocks of 512, which need fewer launches on a GPU, take 2.8 times as long for 28
# transitions on a CPU, and as long for 2,500.
MOST_ON_CPU = 64  # largest block on a CPU


class Rows(eqx.Module):
    """A block of transitions and their features."""

    memory: Memory  # the transitions
    index: Int[Array, "B"]  # their positions
    is_valid: Bool[Array, "B"]  # which of them to count
    phi: Float[Array, "B M"]  # phi(s, a)
    x: Float[Array, "B P"]  # x(s')

    def of(self, array: Shaped[Array, "C *N"]) -> Shaped[Array, "B *N"]:
        """The entries of these transitions."""
        return jax.lax.dynamic_slice_in_dim(array, self.index[0], len(self.index))

    def valid(self, entries: Shaped[Array, "B *N"]) -> Shaped[Array, "B *N"]:
        """The entries of transitions that count, and 0 for the others."""
        is_valid = self.is_valid.reshape(-1, *[1] * (entries.ndim - 1))
        return jnp.where(is_valid, entries, jnp.zeros((), entries.dtype))

    def put(self, arrays: T, entries: T) -> T:
        """Arrays of one entry for each transition, with those of these transitions replaced."""
        return jax.tree.map(
            lambda array, new: jax.lax.dynamic_update_slice_in_dim(array, new, self.index[0], 0),
            arrays,
            entries,
        )


class Transitions(eqx.Module):
    """All transitions of a run and their features, stored or recomputed."""

    state: EMUQState  # state of the learner
    phi: Float[Array, "T M"]  # phi(s, a) of the first transitions
    x: Float[Array, "T P"]  # x(s') of the first transitions
    block: int = eqx.field(static=True)  # number of transitions in a block

    @classmethod
    def of(cls, state: EMUQState, block: int, with_phi: bool) -> "Transitions":
        """The transitions in memory, in blocks of at most `block`.

        Without `with_phi`, phi must not be read: XLA then does not store it.
        """
        number = NUM_STORED_ON_CPU if jax.default_backend() == "cpu" else NUM_STORED
        number = min(number if with_phi else 2 * number, len(state.memory.rewards))

        def visit(arrays, rows, index, is_valid):
            return tuple(
                jax.lax.dynamic_update_slice_in_dim(array, new, index[0], 0)
                for array, new in zip(arrays, features_of(state, rows), strict=True)
            )

        shapes = jax.eval_shape(features_of, state, state.memory)
        start = tuple(jnp.zeros((number, *shape.shape[1:]), shape.dtype) for shape in shapes)
        phi, x = state.memory.fold(visit, start, block, end=number)
        return cls(state, phi, x, block)

    def fold(self, function, start):
        """Fold a function `(carry, rows) -> carry` over blocks of transitions, where `rows` is a `Rows`."""

        def stored(carry, memory, index, is_valid):
            phi, x = (jax.lax.dynamic_slice_in_dim(a, index[0], len(index)) for a in (self.phi, self.x))
            return function(carry, Rows(memory, index, is_valid, phi, x))

        def recomputed(carry, memory, index, is_valid):
            return function(carry, Rows(memory, index, is_valid, *features_of(self.state, memory)))

        # The first transitions are read from the arrays, later ones are computed again in every pass: stored,
        # they would take gigabytes in a batch.
        memory, number = self.state.memory, len(self.phi)
        carry = memory.fold(stored, start, self.block, end=number)
        return memory.fold(recomputed, carry, self.block, first=number)


def largest_block(block: int) -> int:
    """Number of transitions in a block on this machine."""
    return min(block, MOST_ON_CPU) if jax.default_backend() == "cpu" else block


def features_of(state: EMUQState, memory: Memory) -> tuple[Float[Array, "B M"], Float[Array, "B P"]]:
    """phi(s, a) and x(s') of some transitions."""
    phi = jax.vmap(state.features)(memory.observations, memory.actions)
    return phi, jax.vmap(state.features.state)(memory.next_observations)
