"""Collisions with walls and the border of the domain: how far a robot can drive along a path."""

import functools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bojax.motions.base import Pose

Boxes = Float[Array, "W 4"]
"""Axis-parallel rectangles, `[x_min, y_min, x_max, y_max]` in metres."""


class Drive(eqx.Module):
    """The part of a path that was driven.

    Attributes:
        poses: Poses of the path; past the pose at which the robot was stopped, that pose is repeated.
        is_driven: Whether the robot reached each pose of the path.
        collided: Whether a wall stopped the robot.
        exited: Whether the border stopped the robot.
    """

    poses: Float[Array, "S 3"]
    is_driven: Bool[Array, "S"]
    collided: Bool[Array, ""]
    exited: Bool[Array, ""]


def drive_until_blocked(
    start: Pose, poses: Float[Array, "S 3"], domain: Float[Array, "4"], walls: Boxes | None
) -> Drive:
    """Drive through `poses` up to the last one that straight line segments between poses reach.

    A segment that touches a wall or ends outside the domain, and all later ones, are not driven. A segment
    that does both counts as a collision.

    A robot beside a wall may measure a pose inside the wall. The first segment therefore does not collide
    with a wall inside which it starts, provided that it ends beyond the nearest face. This does not apply to
    a start exactly on the face.
    """
    # Unrolled over the few poses and walls, this becomes elementwise arithmetic in one kernel; each reduction
    # and each shifted copy would be a further kernel on a GPU.
    is_on, collided = jnp.ones((), bool), jnp.zeros((), bool)
    before = stop = start
    is_driven = []
    for index in range(poses.shape[0]):
        pose = poses[index]
        is_hit = _touches_any(before, pose, walls, is_first=index == 0)
        collided = collided | (is_on & is_hit)
        is_on = is_on & ~is_hit & _is_inside(pose, domain)
        stop = jnp.where(is_on, pose, stop)
        is_driven.append(is_on)
        before = pose
    reached = jnp.stack(is_driven)
    return Drive(
        poses=jnp.where(reached[:, None], poses, stop[None]),
        is_driven=reached,
        collided=collided,
        exited=~is_on & ~collided,
    )


def is_free(points: Float[Array, "N 2"], domain: Float[Array, "4"], walls: Boxes | None) -> Bool[Array, "N"]:
    """Whether points lie in the domain and outside all walls."""
    return _is_inside(points, domain) & ~_touches_any(points, points, walls)


def _is_inside(points: Float[Array, "*N _"], domain: Float[Array, "4"]) -> Bool[Array, "*N"]:
    x, y = points[..., 0], points[..., 1]
    return (x >= domain[0]) & (y >= domain[1]) & (x <= domain[2]) & (y <= domain[3])


def _touches_any(
    begin: Float[Array, "*N _"], end: Float[Array, "*N _"], walls: Boxes | None, is_first: bool = False
) -> Bool[Array, "*N"]:
    """Whether line segments intersect a wall: the separating axis test with x, y and the segment's normal.

    `across` is twice an area, which avoids a division. The first segment of a path may leave a wall.
    """
    touches = jnp.zeros(begin.shape[:-1], bool)
    low_x, high_x = jnp.minimum(begin[..., 0], end[..., 0]), jnp.maximum(begin[..., 0], end[..., 0])
    low_y, high_y = jnp.minimum(begin[..., 1], end[..., 1]), jnp.maximum(begin[..., 1], end[..., 1])
    step_x, step_y = end[..., 0] - begin[..., 0], end[..., 1] - begin[..., 1]
    for wall in () if walls is None else walls:
        x_min, y_min, x_max, y_max = wall
        is_apart = (high_x < x_min) | (low_x > x_max) | (high_y < y_min) | (low_y > y_max)
        x, y = begin[..., 0] - 0.5 * (x_min + x_max), begin[..., 1] - 0.5 * (y_min + y_max)
        across = jnp.abs(step_x * y - step_y * x)
        widest = 0.5 * ((x_max - x_min) * jnp.abs(step_y) + (y_max - y_min) * jnp.abs(step_x))
        is_apart = is_apart | (across > widest)
        if is_first:
            is_apart = is_apart | _leaves(begin, end, wall)
        touches = touches | ~is_apart
    return touches


def _leaves(
    begin: Float[Array, "*N _"], end: Float[Array, "*N _"], wall: Float[Array, "4"]
) -> Bool[Array, "*N"]:
    """Whether segments start strictly inside a wall and end beyond the face nearest to their start."""
    x_min, y_min, x_max, y_max = wall
    depths = begin[..., 0] - x_min, x_max - begin[..., 0], begin[..., 1] - y_min, y_max - begin[..., 1]
    is_beyond = end[..., 0] < x_min, end[..., 0] > x_max, end[..., 1] < y_min, end[..., 1] > y_max
    depth = functools.reduce(jnp.minimum, depths)
    leaves = [(near == depth) & beyond for near, beyond in zip(depths, is_beyond, strict=True)]
    return (depth > 0.0) & functools.reduce(jnp.logical_or, leaves)
