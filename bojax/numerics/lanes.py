"""The batch axis of the engine, as seen from code written for a single lane."""

import contextlib

import jax
from jaxtyping import Array, Bool, Int

LANES = "lanes"
"""Name of the axis over which the engine batches runs (`vmap(axis_name=LANES)`)."""

EPISODES = "episodes"
"""Name of the axis over which a run batches episodes that do not depend on each other."""


def any_lane(flag: Bool[Array, ""]) -> Bool[Array, ""]:
    """Whether `flag` holds in any lane of this device; `flag` itself outside the engine.

    Where a run batches episodes, whether it holds in any episode of any lane.

    A loop that ends on `any_lane(active)` has an unbatched predicate. With a predicate of each lane, `vmap`
    would add a select of the whole carry to every iteration.
    """
    return _largest(flag)


def largest_in_lanes(number: Int[Array, ""]) -> Int[Array, ""]:
    """The largest `number` of all lanes of this device; `number` itself outside the engine.

    As the trip count of a loop whose length differs between lanes, it keeps the predicate unbatched.
    """
    return _largest(number)


def _largest(x: Array) -> Array:
    for axis in (EPISODES, LANES):
        with contextlib.suppress(NameError):  # there is no such axis
            x = jax.lax.pmax(x, axis)
    return x
