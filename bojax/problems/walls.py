"""Walls and the border of the domain: how far along a path a robot comes."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bojax.motions.base import Pose

Boxes = Float[Array, "W 4"]
"""Axis-parallel rectangles, `[x_min, y_min, x_max, y_max]` in metres."""


class Drive(eqx.Module):
    """How far a robot came along a path.

    Attributes:
        poses: Poses of the path; from where the robot was stopped on, the one it stopped at.
        is_driven: Whether the robot reached that pose of the path.
        collided: It was stopped by a wall.
        exited: It was stopped by the border.
    """

    poses: Float[Array, "S 3"]
    is_driven: Bool[Array, "S"]
    collided: Bool[Array, ""]
    exited: Bool[Array, ""]


def drive_until_blocked(
    start: Pose, poses: Float[Array, "S 3"], domain: Float[Array, "4"], walls: Boxes | None
) -> Drive:
    """Drive through `poses` up to the last one that can be reached in a straight line from the one before.

    A piece that touches a wall or ends outside the domain is not driven, nor is anything after it. A
    piece that does both counts as a collision.
    """
    begin = jnp.concatenate([start[None], poses[:-1]])[:, :2]
    end = poses[:, :2]
    is_outside = jnp.any((end < domain[None, :2]) | (end > domain[None, 2:]), axis=-1)
    if walls is None:
        hits_wall = jnp.zeros_like(is_outside)
    else:
        hits_wall = jnp.any(_touches(begin[:, None], end[:, None], walls[None]), axis=-1)
    # A cumulative product over few poses, unrolled by XLA into elementwise arithmetic.
    is_driven = jnp.cumsum(is_outside | hits_wall) == 0
    number = jnp.sum(is_driven, dtype=jnp.int32)
    is_blocked = number < poses.shape[0]
    collided = is_blocked & hits_wall[jnp.minimum(number, poses.shape[0] - 1)]
    stop = jnp.where(number > 0, poses[jnp.maximum(number - 1, 0)], start)
    return Drive(
        poses=jnp.where(is_driven[:, None], poses, stop[None]),
        is_driven=is_driven,
        collided=collided,
        exited=is_blocked & ~collided,
    )


def is_free(points: Float[Array, "N 2"], domain: Float[Array, "4"], walls: Boxes | None) -> Bool[Array, "N"]:
    """Whether points lie in the domain and in no wall."""
    is_inside = jnp.all((points >= domain[None, :2]) & (points <= domain[None, 2:]), axis=-1)
    if walls is None:
        return is_inside
    return is_inside & ~jnp.any(_touches(points[:, None], points[:, None], walls[None]), axis=-1)


def _touches(
    begin: Float[Array, "*#N 2"], end: Float[Array, "*#N 2"], box: Float[Array, "*#N 4"]
) -> Bool[Array, "*#N"]:
    """Whether a line piece and a rectangle have a point in common, by the slab method."""
    step = end - begin
    is_parallel = step == 0.0
    inverse = 1.0 / jnp.where(is_parallel, 1.0, step)
    low, high = (box[..., :2] - begin) * inverse, (box[..., 2:] - begin) * inverse
    enters, leaves = jnp.minimum(low, high), jnp.maximum(low, high)
    # Along a slab the piece is within it always, or never.
    is_within = (begin >= box[..., :2]) & (begin <= box[..., 2:])
    enters = jnp.where(is_parallel, jnp.where(is_within, -jnp.inf, jnp.inf), enters)
    leaves = jnp.where(is_parallel, jnp.where(is_within, jnp.inf, -jnp.inf), leaves)
    first = jnp.maximum(jnp.max(enters, axis=-1), 0.0)
    last = jnp.minimum(jnp.min(leaves, axis=-1), 1.0)
    return first <= last
