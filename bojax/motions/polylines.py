"""Positions along a polyline, in JAX."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def lengths_along(points: Float[Array, "W 2"]) -> Float[Array, "W"]:
    """Distance from the first point at each point of a polyline, m."""
    pieces = jnp.sqrt(jnp.sum(jnp.diff(points, axis=0) ** 2, axis=-1))
    return jnp.concatenate([jnp.zeros((1,), points.dtype), jnp.cumsum(pieces)])


def points_along(
    points: Float[Array, "W 2"], distances: Float[Array, "S"], step: Float[Array, ""]
) -> tuple[Float[Array, "S 2"], Float[Array, "S"]]:
    """Points at about these distances along a polyline, and where they really are.

    A distance within half a step of a corner is moved to the corner: straight lines between the points would
    otherwise cut corners, and a polyline that bends round an obstacle would run into it. Beyond the end, the
    last point is repeated.

    Args:
        points: Corners of the polyline, m; repeated corners are allowed.
        distances: Distances from its first point, m.
        step: Distance between two of them, m.
    """
    corners = lengths_along(points)
    gaps = jnp.abs(distances[:, None] - corners[None, :])
    nearest = jnp.argmin(gaps, axis=1)
    moved = jnp.where(jnp.min(gaps, axis=1) <= 0.5 * step, corners[nearest], distances)
    moved = jnp.minimum(moved, corners[-1])
    return jnp.stack([jnp.interp(moved, corners, points[:, axis]) for axis in (0, 1)], axis=-1), moved


def headings_along(start: Float[Array, "3"], points: Float[Array, "S 2"]) -> Float[Array, "S"]:
    """Direction from each point's predecessor to the point, rad; where they are equal, the one before."""
    steps = jnp.diff(jnp.concatenate([start[None, :2], points]), axis=0)
    headings, heading = [], start[2]
    for x, y in steps:
        heading = jnp.where((x == 0.0) & (y == 0.0), heading, jnp.arctan2(y, x))
        headings.append(heading)
    return jnp.stack(headings)
