"""The batch axis of the engine, as seen from code written for a single lane."""

import jax
from jaxtyping import Array, Bool, Int

LANES = "lanes"
"""Name of the axis over which the engine batches runs (`vmap(axis_name=LANES)`)."""


def any_lane(flag: Bool[Array, ""]) -> Bool[Array, ""]:
    """Whether `flag` holds in any lane of this device; `flag` itself outside the engine.

    A loop that ends on `any_lane(active)` has an unbatched predicate, so that XLA keeps it a loop: with a
    per-lane predicate, `vmap` adds a select of the whole carry to every iteration.
    """
    return _largest(flag)


def largest_in_lanes(number: Int[Array, ""]) -> Int[Array, ""]:
    """The largest `number` of any lane of this device; `number` itself outside the engine.

    For the trip count of a loop whose length differs between lanes, for the same reason.
    """
    return _largest(number)


def _largest(x: Array) -> Array:
    try:
        return jax.lax.pmax(x, LANES)
    except NameError:  # no such axis: the caller runs a single lane
        return x
