"""Tile coding with a hash table, by the rules of Sutton's tiles3 (Sutton and Barto, 2018, Section 9.5.4).

A tiling divides the space of states into cubes of side 1; tilings are offset against each other. A tile of a
state and a discrete action gets the next free index when it is first used. Once all indices are taken, new
tiles share them, by a hash of their coordinates.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

_LARGEST = 2.0**20  # coordinates are clipped to this, so that they are integers of 32 bits


def tiles(x: Float[Array, "D"], num_tilings: int) -> Int[Array, "T C"]:
    """The tile of a point in each tiling: the number of the tiling, then D coordinates.

    Tiling k is offset by k (2 d + 1) / T along dimension d = 0, ..., D - 1.
    """
    steps = jnp.floor(jnp.clip(x, -_LARGEST, _LARGEST) * num_tilings).astype(jnp.int32)
    tiling = jnp.arange(num_tilings, dtype=jnp.int32)[:, None]
    odd = 2 * jnp.arange(len(x), dtype=jnp.int32) + 1
    return jnp.concatenate([tiling, (steps[None, :] + tiling * odd[None, :]) // num_tilings], axis=1)


class TileTable(eqx.Module):
    """The indices of the tiles seen so far, at most N of them."""

    hashes: UInt32[Array, "K 2"]  # two hashes of the tile of each row in use
    first: Int[Array, "K"]  # index of each tile with action 0
    stride: Int[Array, "K"]  # difference of its indices with one action and the next
    num_rows: Int[Array, ""]  # number of rows in use
    num_used: Int[Array, ""]  # number of indices in use
    size: int = eqx.field(static=True)  # number of indices, N
    num_actions: int = eqx.field(static=True)  # number of actions, A

    @classmethod
    def empty(cls, size: int, num_tilings: int, num_actions: int) -> "TileTable":
        """A table without tiles."""
        # The tiles of the last state that gets indices may get them for its first action only.
        capacity = size // num_actions + num_tilings
        zero, zeros = jnp.zeros((), jnp.int32), jnp.zeros((capacity,), jnp.int32)
        return cls(jnp.zeros((capacity, 2), jnp.uint32), zeros, zeros, zero, zero, size, num_actions)

    def look_up(
        self, tiles: Int[Array, "T C"], is_kept: Bool[Array, ""] | bool = True
    ) -> tuple["TileTable", Int[Array, "A T"]]:
        """The indices of a state's tiles with every action, and the table with the new ones.

        The indices do not depend on `is_kept`: whether new tiles are stored.
        """
        # The tiles of a state get their indices for all A actions at once, in the order of actions and then
        # of tilings: if m tiles are new, the indices of the next action are higher by m, and one row serves
        # all actions.
        hashes = hashes_of(tiles)
        row = self._row_of(hashes)
        is_new = row < 0
        count = jnp.cumsum(is_new, dtype=jnp.int32)
        rank, number = count - 1, count[-1]
        first = jnp.where(is_new, self.num_used + rank, self.first[row])
        stride = jnp.where(is_new, number, self.stride[row])

        action = jnp.arange(self.num_actions, dtype=jnp.int32)[:, None]
        index = first[None, :] + action * stride[None, :]
        index = jnp.where(index < self.size, index, self._hashed(tiles, action))

        is_stored = is_new & (first < self.size) & is_kept
        place = jnp.where(is_stored, self.num_rows + rank, len(self.first))
        grown = jnp.minimum(self.num_used + number * self.num_actions, self.size)
        table = replace(
            self,
            hashes=self.hashes.at[place].set(hashes, mode="drop"),
            first=self.first.at[place].set(first, mode="drop"),
            stride=self.stride.at[place].set(stride, mode="drop"),
            num_rows=self.num_rows + jnp.sum(is_stored, dtype=jnp.int32),
            num_used=jnp.where(is_kept, grown, self.num_used),
        )
        return table, index

    def _row_of(self, hashes: UInt32[Array, "T 2"]) -> Int[Array, "T"]:
        """The row of each tile; -1 for one that has none."""
        # The two columns are compared one by one, so that a GPU needs one kernel for all: it would write what
        # `jnp.all` finds for every pair of a tile and a row to its memory.
        (a, b), (rows_a, rows_b) = hashes.T, self.hashes.T
        row = jnp.arange(len(self.hashes), dtype=jnp.int32)
        is_equal = (a[:, None] == rows_a[None, :]) & (b[:, None] == rows_b[None, :])
        is_equal = is_equal & (row < self.num_rows)[None, :]
        return jnp.max(jnp.where(is_equal, row[None, :], -1), axis=1)

    @eqx.filter_jit  # traced and lowered once for all look-ups of a program
    def _hashed(self, tiles: Int[Array, "T C"], action: Int[Array, "A 1"]) -> Int[Array, "A T"]:
        shape = (self.num_actions, len(tiles))
        columns = [jnp.broadcast_to(column[None, :], shape) for column in tiles.T]
        number = tuple_hash([*columns, jnp.broadcast_to(action, shape)])
        return (number % jnp.uint32(self.size)).astype(jnp.int32)


def tuple_hash(columns: list[Int[Array, "*N"]]) -> UInt32[Array, "*N"]:
    """Hashes of tuples of integers, given as columns: CPython's xxHash for tuples, in 32 bits."""
    total = jnp.full_like(columns[0], 374761393, jnp.uint32)
    for column in columns:
        total = total + column.astype(jnp.uint32) * jnp.uint32(2246822519)
        total = (total << jnp.uint32(13)) | (total >> jnp.uint32(19))
        total = total * jnp.uint32(2654435761)
    return total + jnp.uint32(len(columns) ^ 374761393 ^ 3527539)


@eqx.filter_jit  # traced and lowered once, too
def hashes_of(tiles: Int[Array, "T C"]) -> UInt32[Array, "T 2"]:
    """Two hashes by which tiles are known: any two of 1,000 tiles share both with a probability of 3e-14."""
    # Most of a look-up is the comparison of tiles with all rows. With all coordinates, a core makes 0.6 times
    # as many steps/s of the double pendulum, which has six. Of 14 million tiles near each other, 19,000 share
    # the first hash, and none the second as well. With a second one that begins with another number, 220 do:
    # where two columns make up for each other, they do so from any beginning, but not in the other order.
    columns = list(tiles.T)
    return jnp.stack([tuple_hash(columns), tuple_hash(columns[::-1])], axis=1)


def is_first(index: Int[Array, "*N T"]) -> Bool[Array, "*N T"]:
    """Whether each index is its row's first occurrence, so that tiles hashed to one index count once."""
    earlier = jnp.tril(jnp.ones(2 * index.shape[-1:], bool), -1)
    is_equal = index[..., :, None] == index[..., None, :]
    return ~jnp.any(is_equal & jnp.broadcast_to(earlier, is_equal.shape), axis=-1)
