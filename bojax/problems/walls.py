"""Walls and the border of the domain: how far along a path a robot comes."""

import functools

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

    A robot beside a wall may read a pose inside it. So the first piece does not touch a wall that it begins
    inside of if it ends beyond the nearest face; on the face itself nothing is forgiven.
    """
    # Unrolled over a handful of poses and walls, XLA makes it elementwise arithmetic in one kernel, where
    # every reduction and every shifted copy would be one more on a GPU.
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
    """Whether points lie in the domain and in no wall."""
    return _is_inside(points, domain) & ~_touches_any(points, points, walls)


def _is_inside(points: Float[Array, "*N _"], domain: Float[Array, "4"]) -> Bool[Array, "*N"]:
    x, y = points[..., 0], points[..., 1]
    return (x >= domain[0]) & (y >= domain[1]) & (x <= domain[2]) & (y <= domain[3])


def _touches_any(
    begin: Float[Array, "*N _"], end: Float[Array, "*N _"], walls: Boxes | None, is_first: bool = False
) -> Bool[Array, "*N"]:
    """Whether line pieces have a point in common with a wall: no axis separates the two.

    The axes are x, y and the piece's normal; `across` is twice an area, so that nothing is divided. First
    pieces of a path may leave a wall.
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
    """Whether line pieces begin inside a wall, not on its faces, and end beyond the face nearest to that."""
    x_min, y_min, x_max, y_max = wall
    depths = begin[..., 0] - x_min, x_max - begin[..., 0], begin[..., 1] - y_min, y_max - begin[..., 1]
    is_beyond = end[..., 0] < x_min, end[..., 0] > x_max, end[..., 1] < y_min, end[..., 1] > y_max
    depth = functools.reduce(jnp.minimum, depths)
    leaves = [(near == depth) & beyond for near, beyond in zip(depths, is_beyond, strict=True)]
    return (depth > 0.0) & functools.reduce(jnp.logical_or, leaves)
