"""Steps of `bojax.models.lookahead` as kernels for NVIDIA GPUs."""

import functools
import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bojax.numerics.linalg import HIGHEST
from bojax.numerics.pallas import imported, kernels_run_here, launch, power_of_two

BAND = 32  # rows and columns of the blocks of L^-1 that a kernel reads


def are_used(number: int, num_given: int, dtype: Any) -> bool:
    """Whether a look-ahead at `number` points, `num_given` of them in all stages but the last, uses kernels.

    It does for the sizes at which they were measured to be faster. The program of `conditioned` grows with
    the cube of `num_given`.
    """
    return kernels_run_here() and dtype == jnp.float64 and number <= 32 and 0 < num_given <= 16


def whitened(
    inverse_cholesky: Float[Array, "N N"], gram: Float[Array, "N B"], count: Int[Array, ""]
) -> Float[Array, "N B"]:
    """L^-1 k(X, Z), without reading blocks of L^-1 that are zero: above the diagonal, and past `count`.

    Each program of the grid computes `BAND` rows.
    """
    size, width = gram.shape[0], power_of_two(gram.shape[1])

    def body(factor_ref: Any, gram_ref: Any, count_ref: Any, out_ref: Any) -> None:
        # All indices are explicitly 32-bit: in JAX's 64-bit mode, Python integers would become 64-bit.
        pallas, triton = imported()
        own = pallas.program_id(0).astype(np.int32)

        def add(block: Any, total: jax.Array) -> jax.Array:
            factor = _load(factor_ref, (own * np.int32(BAND), BAND), (block * np.int32(BAND), BAND))
            part = _load(gram_ref, (block * np.int32(BAND), BAND), (np.int32(0), width))
            return total + jnp.dot(factor, part, precision=HIGHEST)

        # L^-1 is lower triangular: band `own` has blocks 0 to `own`, and none if it lies past the
        # observations.
        is_held = own * np.int32(BAND) < count_ref[...]
        number = jnp.where(is_held, own + np.int32(1), np.int32(0))
        total = jax.lax.fori_loop(np.int32(0), number, add, jnp.zeros((BAND, width), gram.dtype))
        tile, inside = _tile(out_ref, (own * np.int32(BAND), BAND), (np.int32(0), width))
        triton.store(tile, total, mask=inside)

    return _in_bands(body, gram, size, inverse_cholesky, gram, count, name="whitened")


def explained_away(
    rows: Float[Array, "S N"], inverse_cholesky: Float[Array, "N N"], count: Int[Array, ""]
) -> Float[Array, "S N"]:
    """A few rows times L^-1; as in `whitened`, blocks of L^-1 that are zero are not read.

    Each program of the grid computes `BAND` columns.
    """
    size, height = rows.shape[1], max(16, power_of_two(rows.shape[0]))  # Triton's least is 16

    def body(rows_ref: Any, factor_ref: Any, count_ref: Any, out_ref: Any) -> None:
        pallas, triton = imported()
        own = pallas.program_id(0).astype(np.int32)

        def add(block: Any, total: jax.Array) -> jax.Array:
            part = _load(rows_ref, (np.int32(0), height), (block * np.int32(BAND), BAND))
            factor = _load(factor_ref, (block * np.int32(BAND), BAND), (own * np.int32(BAND), BAND))
            return total + jnp.dot(part, factor, precision=HIGHEST)

        # Column band `own` of L^-1 has entries from its own diagonal block down to the last observation.
        end = (count_ref[...] + np.int32(BAND - 1)) // np.int32(BAND)
        total = jax.lax.fori_loop(own, end, add, jnp.zeros((height, BAND), rows.dtype))
        tile, inside = _tile(out_ref, (np.int32(0), height), (own * np.int32(BAND), BAND))
        triton.store(tile, total, mask=inside)

    return _in_bands(body, rows, size, rows, inverse_cholesky, count, name="explained_away")


def conditioned(
    joint: Float[Array, "B B"],
    least: Float[Array, "B"],
    innovations: Float[Array, "G"],
    num_stages: int,
    with_weights: bool,
) -> tuple[Float[Array, "B"], Float[Array, "B"], Float[Array, "G T"] | None]:
    """`bojax.models.lookahead.conditioned` as one kernel.

    Each thread computes the whole Cholesky factor L of the leading block as scalars, and one or two columns
    of L^-1 [joint | I]. The column of a point is the row of the factor that belongs to the point. All
    results are therefore sums over the rows of a column, and no thread waits for another.
    """
    size, given = joint.shape[0], innovations.shape[0]
    stage_size = size // num_stages
    columns, results = (size + given, num_stages + 1) if with_weights else (size, 2)
    width, height, few = map(power_of_two, (columns, given, results))

    def body(joint_ref: Any, least_ref: Any, innovations_ref: Any, out_ref: Any) -> None:
        _, triton = imported()
        row = jax.lax.broadcasted_iota(np.int32, (height, width), 0)
        column = jax.lax.broadcasted_iota(np.int32, (height, width), 1)
        right = _load(joint_ref, (np.int32(0), height), (np.int32(0), width))
        right = jnp.where(column == size + row, 1.0, right)  # [joint | I]; loading past the end gave zeros
        index = jnp.arange(width, dtype=np.int32)
        shift = explained = jnp.zeros((width,), joint.dtype)
        weights = [shift] * (results - 2)
        factor: list[list[jax.Array]] = []
        inverse_pivots: list[jax.Array] = []
        solved: list[jax.Array] = []
        for i in range(given):
            # The row of the factor, and the row of L^-1 [joint | I].
            entries: list[jax.Array] = []
            own = jnp.sum(jnp.where(row == i, right, 0.0), axis=0)
            for j in range(i):
                rest = joint_ref[np.int32(i), np.int32(j)]
                for k in range(j):
                    rest = rest - entries[k] * factor[j][k]
                entries.append(rest * inverse_pivots[j])
                own = own - entries[j] * solved[j]
            square = joint_ref[np.int32(i), np.int32(i)]
            for entry in entries:
                square = square - entry * entry
            inverse_pivots.append(1.0 / jnp.sqrt(jnp.maximum(square, least_ref[np.int32(i)])))
            factor.append(entries)
            solved.append(own * inverse_pivots[i])
            # Later stages know the observation.
            stage, innovation = i // stage_size, innovations_ref[np.int32(i)]
            seen = jnp.where(index >= (stage + 1) * stage_size, solved[i], 0.0)
            shift, explained = shift + seen * innovation, explained + seen * seen
            for later in range(stage, len(weights)):
                weights[later] = weights[later] + solved[i] * innovation
        place = jax.lax.broadcasted_iota(np.int32, (few, width), 0)
        found = jnp.zeros((few, width), joint.dtype)
        for number, values in enumerate([shift, explained, *weights]):
            found = jnp.where(place == number, values[None, :], found)
        tile, inside = _tile(out_ref, (np.int32(0), few), (np.int32(0), width))
        triton.store(tile, found, mask=inside)

    result = jax.ShapeDtypeStruct((results, columns), joint.dtype)
    (found,) = launch(body, [result], joint, least, innovations, name="conditioned")
    weights = jnp.pad(found[2:, size:], ((1, 0), (0, 0))).T if with_weights else None
    return found[0, :size], found[1, :size], weights


def _in_bands(
    body: Callable[..., None], like: jax.Array, size: int, *args: jax.Array, name: str
) -> jax.Array:
    """An array like `like`; each program computes `BAND` of its `size` rows or columns."""
    result = jax.ShapeDtypeStruct(like.shape, like.dtype)
    return launch(body, [result], *args, name=name, grid=(-(-size // BAND),), warps=4, stages=3)[0]


def _tile(ref: Any, *axes: tuple[Any, int]) -> tuple[Any, jax.Array]:
    """A block of an array, by the start and the size along each axis, and which of its elements exist."""
    pallas, _ = imported()
    inside = []
    for axis, (start, size) in enumerate(axes):
        index = start + jnp.arange(size, dtype=np.int32)
        shape = [size if other == axis else 1 for other in range(len(axes))]
        inside.append((index < ref.shape[axis]).reshape(shape))
    # If a start is known, Pallas refuses a block that ends past the array, whatever the mask.
    starts = [start + jnp.zeros((), np.int32) for start, _ in axes]
    blocks = tuple(pallas.ds(start, size) for start, (_, size) in zip(starts, axes, strict=True))
    return ref.at[blocks], functools.reduce(operator.and_, inside)


def _load(ref: Any, *axes: tuple[Any, int]) -> jax.Array:
    """A block of an array, 0 past its end."""
    _, triton = imported()
    tile, inside = _tile(ref, *axes)
    return triton.load(tile, mask=inside, other=0.0)
