"""The batch axis of the engine, as seen from code written for a single lane."""

import jax
from jaxtyping import Array, Bool

LANES = "lanes"
"""Name of the axis over which the engine batches runs (`vmap(axis_name=LANES)`)."""


def any_lane(flag: Bool[Array, ""]) -> Bool[Array, ""]:
    """Whether `flag` holds in any lane of this device; `flag` itself outside the engine.

    A loop that ends on `any_lane(active)` has an unbatched predicate, so that XLA keeps it a loop: with a
    per-lane predicate, `vmap` adds a select of the whole carry to every iteration.
    """
    try:
        return jax.lax.pmax(flag, LANES)
    except NameError:  # no such axis: the caller runs a single lane
        return flag
