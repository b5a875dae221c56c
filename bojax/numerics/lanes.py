"""The batch axis of the engine, as seen from code written for a single lane."""

import contextlib
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.extend.core import jaxpr_as_fun
from jaxtyping import Array, ArrayLike, Bool, Int

T = TypeVar("T")  # A tree of arrays

LANES = "lanes"
"""Name of the axis over which the engine batches runs (`vmap(axis_name=LANES)`).

Its size is 1 while the engine traces an experiment: use `lax.pmax`, `pmin` or `psum`, not `pmean` or
`axis_size`.
"""

LANES_ON_GPU = 4096
"""Default number of lanes of a GPU, unless its memory allows fewer."""

EPISODES = "episodes"  # name of the axis over which a run batches episodes that do not depend on each other
TREES = "trees"  # name of the axis over which a plan batches independent searches


def any_lane(flag: Bool[Array, ""]) -> Bool[Array, ""]:
    """Whether `flag` holds in any lane of this device; `flag` itself outside the engine.

    Where a run also batches episodes, or a plan batches trees, whether it holds in any of these of any lane.
    """
    # A loop that ends on `any_lane(active)` has an unbatched predicate. With a predicate of each lane, `vmap`
    # would add a select of the whole carry to every iteration.
    return _largest(flag)


def in_own_kernel(flag: Bool[Array, "..."], turn: Int[Array, ""]) -> Bool[Array, "..."]:
    """`flag`, the condition of a loop that carries it, in a form that a GPU has to compute in each turn."""
    # With one lane, the flag of the carry is the condition, and nothing is left to compute. In a CUDA graph,
    # XLA (of JAX 0.11.2) would then read it too early: the kernel that reads a condition waits only for those
    # that compute it. XLA does not know that a turn is never negative, so the comparison stays.
    return flag & (turn >= 0)


def largest_in_lanes(number: Int[Array, ""]) -> Int[Array, ""]:
    """The largest `number` of all lanes of this device; `number` itself outside the engine."""
    # As the trip count of a loop whose length differs between lanes, it keeps the predicate unbatched.
    return _largest(number)


def _largest(x: Array) -> Array:
    for axis in (TREES, EPISODES, LANES):
        with contextlib.suppress(NameError):  # there is no such axis
            x = jax.lax.pmax(x, axis)
    return x


def batched_together(tree: T) -> T:
    """A tree of arrays, with all of them batched if any is.

    For the initial values of a loop whose body batches them all. A value that all lanes share must be left
    out, or each lane gets a copy of it.
    """
    # The program is the same and compiles in less time: `vmap` batches the body of a loop to learn which of
    # its results are batched, and again until no further ones are.
    leaves, structure = jax.tree.flatten(tree)
    return jax.tree.unflatten(structure, _differentiable(leaves))


@jax.custom_jvp
def _differentiable(arrays: Sequence[ArrayLike]) -> list[ArrayLike]:
    """`_together` with its derivative, the identity: `custom_vmap` alone has no reverse mode."""
    return list(_together(*arrays))


@_differentiable.defjvp
def _derivative(primals, tangents):
    return _differentiable(*primals), list(*tangents)


@jax.custom_batching.custom_vmap
def _together(*arrays: ArrayLike) -> tuple[ArrayLike, ...]:
    return arrays


@_together.def_vmap
def _together_in_lanes(num_lanes: int, is_batched: Sequence[bool], *arrays: ArrayLike):
    together = tuple(
        array if batched else jnp.broadcast_to(array, (num_lanes, *jnp.shape(array)))
        for array, batched in zip(arrays, is_batched, strict=True)
    )
    return together, (True,) * len(arrays)


@jax.custom_batching.custom_vmap
def write_row(rows: Array, index: Int[Array, ""], row: Array) -> Array:
    """`rows` with one row replaced. In a batch, the index must be in range.

    `vmap` alone would turn this into a scatter, which checks the range of its indices: two kernels on a GPU.
    It is a slice if the index is the same in all lanes.
    """
    return jax.lax.dynamic_update_index_in_dim(rows, row, index, 0)


@write_row.def_vmap
def _write_row_of_lanes(num_lanes: int, is_batched, rows: Array, index: Array, row: Array):
    if is_batched[1]:
        axes = [0 if batched else None for batched in is_batched]
        return jax.vmap(lambda rows, index, row: rows.at[index].set(row, mode="promise_in_bounds"), axes)(
            rows, index, row
        ), True
    if not is_batched[0]:
        rows = jnp.broadcast_to(rows, (num_lanes, *rows.shape))
    if not is_batched[2]:
        row = jnp.broadcast_to(row, (num_lanes, *row.shape))
    # The same row of every lane: one slice along axis 1 of the batch, whose axis 0 are the lanes.
    return jax.lax.dynamic_update_index_in_dim(rows, row, index, 1), True


def lane_by_lane_on_cpu(function: Callable[..., T], *arguments: Any) -> T:
    """`function(*arguments)`, computed on a CPU for one lane after the other.

    For a function with loops whose lengths differ between lanes. `arguments` are trees of arrays with all
    numbers that the function reads.
    """
    # In a batch, each iteration computes all lanes until the last one ends; lane by lane, each ends on its
    # own, and its arrays stay in the cache.
    if jax.default_backend() != "cpu":
        return function(*arguments)
    leaves, structure = jax.tree.flatten(arguments)

    def flat(*leaves: Array) -> T:
        return function(*jax.tree.unflatten(structure, leaves))

    traced, shape = jax.make_jaxpr(flat, return_shape=True)(*leaves)  # once, for all that follows
    compute = jaxpr_as_fun(traced)
    in_turn = jax.custom_batching.custom_vmap(compute)

    @in_turn.def_vmap
    def _(num_lanes: int, is_batched: Sequence[bool], *leaves: ArrayLike):
        axes = [0 if batched else None for batched in is_batched]
        # A batch of one lane, whose axis has a name.
        one = jax.vmap(compute, axes, axis_name=LANES)

        def lane(own: Sequence[Array]) -> list[Array]:
            rest = iter(own)
            return one(*(next(rest) if batched else x for x, batched in zip(leaves, is_batched, strict=True)))

        own = [jnp.asarray(x)[:, None] for x, batched in zip(leaves, is_batched, strict=True) if batched]
        results = jax.tree.map(lambda x: x[:, 0], jax.lax.map(lane, own))
        return results, jax.tree.map(lambda _: True, results)

    return jax.tree.unflatten(jax.tree.structure(shape), in_turn(*leaves))
