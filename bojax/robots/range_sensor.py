"""A range finder over a surface: rays of a narrow cone, marched to their first intersection.

MJX's own range finder does not support height fields. A surface here is any function of the plane, so that
the sensor measures exactly the field with which a reconstruction is compared.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bojax.numerics.linalg import matmul

Surface = Callable[[Float[Array, "N 2"]], Float[Array, "N"]]
"""Function from points of the plane to heights in metres."""

NUM_MARCHED = 64
"""Number of segments of a ray among which the first crossing of the surface is searched for."""

NUM_HALVINGS = 18
"""Number of bisections of the crossing segment, which reduce 5 cm to 0.2 micrometres."""

_GOLDEN_ANGLE = np.pi * (3.0 - 5.0**0.5)


def cone(opening: Float[Array, ""], num_rays: int) -> Float[Array, "K 3"]:
    """Unit vectors evenly distributed over a cone about -z, the first on its axis, the last on its rim.

    The opening is the full angle, in rad.
    """
    index = np.arange(num_rays)
    radius = jnp.asarray(np.sqrt(index / max(num_rays - 1, 1)), opening.dtype)
    around = jnp.asarray(np.mod(index * _GOLDEN_ANGLE, 2.0 * np.pi), opening.dtype)
    angle = 0.5 * opening * radius
    side = jnp.sin(angle)
    return jnp.stack([side * jnp.cos(around), side * jnp.sin(around), -jnp.cos(angle)], axis=-1)


def ranges(
    surface: Surface,
    origin: Float[Array, "3"],
    rotation: Float[Array, "3 3"],
    rays: Float[Array, "K 3"],
    max_range: Float[Array, ""],
) -> Float[Array, "K"]:
    """Distances along rays to the first point at or below a surface, `max_range` for a ray that misses it.

    Each ray is marched in 64 equal segments, and the first segment that ends below the surface is bisected.
    An obstacle that a ray enters and leaves within one segment is missed. Lengths are in metres. The rays are
    unit vectors in the sensor frame, which the rotation takes to the world frame.
    """
    directions = matmul(rays, rotation.T)

    def is_below(distance: Float[Array, "K M"]) -> Bool[Array, "K M"]:
        points = origin[None, None] + distance[..., None] * directions[:, None]
        heights = surface(points[..., :2].reshape(-1, 2)).reshape(distance.shape)
        return points[..., 2] <= heights

    marched = max_range * jnp.arange(NUM_MARCHED + 1, dtype=rays.dtype) / NUM_MARCHED
    was_hit = is_below(jnp.broadcast_to(marched[None], (rays.shape[0], NUM_MARCHED + 1)))
    # The first True of each ray; 0 for a ray without any, whose result is replaced at the end.
    first = jnp.argmax(was_hit, axis=1)
    far = marched[first]
    near = jnp.maximum(far - max_range / NUM_MARCHED, 0.0)

    def halve(_, between):
        near, far = between
        middle = 0.5 * (near + far)
        hit = is_below(middle[:, None])[:, 0]
        return jnp.where(hit, near, middle), jnp.where(hit, middle, far)

    _, far = jax.lax.fori_loop(0, NUM_HALVINGS, halve, (near, far))
    return jnp.where(jnp.any(was_hit, axis=1), far, max_range)
