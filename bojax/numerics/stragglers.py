"""Loops over many lanes that mostly end early.

For GPUs. A CPU computes such loops for one lane after the other: `bojax.numerics.lanes.lane_by_lane_on_cpu`.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import eval_jaxpr
from jaxtyping import Array, ArrayLike, Bool, Int

from bojax.numerics.lanes import LANES

T = TypeVar("T")
"""A tree of arrays."""

SHARE = 8
"""The lanes that are still going run alone once they are one in `SHARE`, or fewer."""

LEAST = 64
"""In a batch of fewer lanes none run alone, since a longer program would gain little there."""


def while_going(
    is_going: Callable[[T], Bool[Array, ""]], step: Callable[[Int[Array, ""], T], T], state: T
) -> T:
    """Repeat `state = step(number, state)` while `is_going(state)`, for number = 0, 1, ...

    In a batch, each step of a loop computes all lanes until the last one ends. Here, the few lanes that go on
    longest are gathered into a batch of their own, with all arrays that `step` reads, and finish there. The
    program contains the step twice.

    Args:
        is_going: Whether a lane goes on.
        step: The step. A lane that is not going must not go on again, and the step must leave what the caller
            reads of its state unchanged.
        state: First state.

    Returns:
        The last state.
    """
    leaves, structure = jax.tree.flatten(state)

    def flat(number: Array, leaves: list[Any]) -> list[Any]:
        return jax.tree.leaves(step(number, jax.tree.unflatten(structure, leaves)))

    def goes(leaves: list[Any]) -> Array:
        return is_going(jax.tree.unflatten(structure, leaves))

    # A function with a batching rule of its own must not close over traced arrays. Tracing collects those
    # that the step reads as constants, which become an argument of the loop.
    zero = np.zeros((), np.int32)
    traced = jax.make_jaxpr(flat)(zero, leaves)

    def computed(number: ArrayLike, leaves: list[Any], read: list[Any]) -> list[Any]:
        return eval_jaxpr(traced.jaxpr, read, number, *leaves)

    @jax.custom_batching.custom_vmap
    def loop(leaves, read):
        def body(carry):
            number, leaves = carry
            return number + 1, computed(number, leaves, read)

        return jax.lax.while_loop(lambda carry: goes(carry[1]), body, (zero, leaves))[1]

    @loop.def_vmap
    def _(num_lanes, is_batched, leaves, read):
        # Arrays that all lanes share, such as a table of features, are not copied for each lane.
        axes = [0 if batched else None for batched in is_batched[1]]
        leaves = [
            leaf if batched else jnp.broadcast_to(leaf, (num_lanes, *leaf.shape))
            for leaf, batched in zip(leaves, is_batched[0], strict=True)
        ]
        steps = jax.vmap(computed, (None, 0, axes), axis_name=LANES)

        def until(most: int, number: ArrayLike, leaves: list[Any], read: list[Any]):
            """The loop until at most `most` lanes are going."""

            def body(carry):
                number, leaves = carry
                return number + 1, steps(number, leaves, read)

            return jax.lax.while_loop(
                lambda carry: jnp.sum(jax.vmap(goes)(carry[1])) > most, body, (number, leaves)
            )

        few = num_lanes // SHARE if num_lanes >= LEAST else 0
        number, leaves = until(few, zero, leaves, read)
        if few:
            # A stable sort puts the lanes that are going first. If they are fewer than `few`, lanes that have
            # ended fill up the batch, whose shape is fixed; the step leaves them unchanged.
            chosen = jnp.argsort(~jax.vmap(goes)(leaves))[:few]
            own = [x if axis is None else x[chosen] for x, axis in zip(read, axes, strict=True)]
            _, ended = until(0, number, [leaf[chosen] for leaf in leaves], own)
            # The lanes are distinct, so that XLA may scatter without atomic operations.
            leaves = [
                leaf.at[chosen].set(new, unique_indices=True) for leaf, new in zip(leaves, ended, strict=True)
            ]
        return leaves, [True] * len(leaves)

    return jax.tree.unflatten(structure, loop(leaves, traced.consts))
