"""Collisions with walls and the border of the domain: how far a robot can drive along a path."""

import functools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bojax.areas.outlined import OutlinedArea
from bojax.models.checks import compiled_if_known

Boxes = Float[Array, "W 4"]
"""Axis-parallel rectangles, `[x_min, y_min, x_max, y_max]` in metres."""


ROUNDING = 1e-9  # of distances: metres, and share of a distance


class Drive(eqx.Module):
    """The part of a path that was driven."""

    # Poses of the path; past the pose at which the robot was stopped, that pose is repeated
    poses: Float[Array, "S 3"]
    is_driven: Bool[Array, "S"]  # whether the robot reached each pose of the path
    collided: Bool[Array, ""]  # whether a wall or the border of the area stopped the robot
    exited: Bool[Array, ""]  # whether the border stopped the robot

    def length_from(self, start: Float[Array, "3"]) -> Float[Array, ""]:
        """Its length from its start, m."""
        return jnp.sum(self._lengths(start))

    def _lengths(self, start: Float[Array, "3"]) -> Float[Array, "S"]:
        points = jnp.concatenate([start[None, :2], self.poses[:, :2]])
        return jnp.sqrt(jnp.sum(jnp.diff(points, axis=0) ** 2, axis=-1))

    def within(
        self, start: Float[Array, "3"], left: Float[Array, ""], to_end: Float[Array, "T"] | None = None
    ) -> tuple["Drive", Float[Array, ""]]:
        """The part of the drive of at most `left` metres from its start, and the distance left after it.

        Where the distance does not suffice, the robot stops at the last pose that it reaches, and none is
        left: what remains does not reach any further pose. If the mission must end at a point, it stops at
        the last pose from which the point is reached, and the distance to it is left; so it is after a path
        that stays where it is, as at the end of a route. `to_end` is that distance from the start and from
        each pose, m.
        """
        driven = jnp.cumsum(self._lengths(start))
        # Rounding of the sums does not leave out a pose that lies exactly at the end.
        limit = left * (1.0 + ROUNDING) + ROUNDING
        if to_end is None:
            reaches = self.is_driven & (driven <= limit)
        else:
            reaches = jnp.cumsum(~(self.is_driven & (driven + to_end[1:] <= limit))) == 0
        is_cut = jnp.sum(reaches) < jnp.sum(self.is_driven)
        number = jnp.sum(reaches).astype(jnp.int32)
        index = jnp.arange(1, len(self.poses) + 1, dtype=jnp.int32)
        poses = jnp.concatenate([start[None], self.poses])[jnp.minimum(index, number)]
        rest = jnp.maximum(left - jnp.max(jnp.where(reaches, driven, 0.0)), 0.0)
        is_used = rest <= left * ROUNDING + ROUNDING
        if to_end is None:
            rest = jnp.where(is_cut | is_used, 0.0, rest)
        else:
            stays = is_rounding(driven[-1], start) & ~self.collided & ~self.exited
            rest = jnp.where(is_cut | stays, to_end[number], jnp.where(is_used, 0.0, rest))
            rest = jnp.where(rest <= ROUNDING, 0.0, rest)
        # A wall behind the end of the budget stops nobody.
        return Drive(poses, reaches, self.collided & ~is_cut, self.exited & ~is_cut), rest


def is_rounding(length: Float[Array, ""], start: Float[Array, "3"]) -> Bool[Array, ""]:
    """Whether a path from a pose is so short, m, that its poses differ by rounding alone."""
    eps = jnp.finfo(length.dtype).eps
    return length <= 100.0 * eps * (1.0 + jnp.max(jnp.abs(start[:2])))


@eqx.filter_jit  # traced and lowered once where a program drives several times
def drive_until_blocked(
    trajectory: Float[Array, "T 3"],
    domain: Float[Array, "4"],
    walls: Boxes | None,
    area: OutlinedArea | None = None,
) -> Drive:
    """Drive from the first pose of a trajectory up to the last one that straight line segments reach.

    A segment that touches a wall, leaves the area or ends outside the domain, and all later ones, are not
    driven. A segment that does the last and another counts as a collision. The first segment may leave a wall
    that it starts inside of.
    """
    # A robot beside a wall may measure a pose inside it: the first segment does not collide with such a wall
    # if it ends beyond the nearest face. This does not apply to a start exactly on the face. The segments are
    # one array and the few walls are unrolled: elementwise arithmetic in one kernel, where a reduction over
    # the walls would be a further kernel on a GPU. Unrolled over the segments as well, the program takes
    # twice as long to compile.
    poses = trajectory[1:]
    is_hit = _touches_any(trajectory[:-1], poses, walls, may_leave=True)
    if area is not None:
        is_hit = is_hit | area.is_blocked(trajectory)
    is_free = ~is_hit & is_inside(poses, domain)
    is_on, collided, number = jnp.ones((), bool), jnp.zeros((), bool), jnp.zeros((), jnp.int32)
    for index in range(poses.shape[0]):
        collided = collided | (is_on & is_hit[index])
        is_on = is_on & is_free[index]
        number = number + is_on.astype(jnp.int32)
    index = jnp.arange(1, poses.shape[0] + 1, dtype=jnp.int32)
    return Drive(
        poses=trajectory[jnp.minimum(index, number)],
        is_driven=index <= number,
        collided=collided,
        exited=~is_on & ~collided,
    )


@compiled_if_known
def is_free(
    points: Float[Array, "N 2"],
    domain: Float[Array, "4"],
    walls: Boxes | None,
    area: OutlinedArea | None = None,
) -> Bool[Array, "N"]:
    """Whether points lie in the domain, in the area, and outside all walls."""
    free = is_inside(points, domain) & ~_touches_any(points, points, walls)
    return free if area is None else free & area.is_inside(points)


def is_inside(points: Float[Array, "*N _"], domain: Float[Array, "4"]) -> Bool[Array, "*N"]:
    """Whether points lie in a box `[x_min, y_min, x_max, y_max]` or on its border."""
    x, y = points[..., 0], points[..., 1]
    return (x >= domain[0]) & (y >= domain[1]) & (x <= domain[2]) & (y <= domain[3])


def _touches_any(
    begin: Float[Array, "*N _"], end: Float[Array, "*N _"], walls: Boxes | None, may_leave: bool = False
) -> Bool[Array, "*N"]:
    """Whether line segments intersect a wall. With `may_leave`, the first segment may leave a wall."""
    touches = jnp.zeros(begin.shape[:-1], bool)
    for wall in () if walls is None else walls:
        touches = touches | _touches(begin, end, wall, may_leave)
    return touches


@eqx.filter_jit  # traced and lowered once for all walls
def _touches(
    begin: Float[Array, "*N _"], end: Float[Array, "*N _"], wall: Float[Array, "4"], may_leave: bool
) -> Bool[Array, "*N"]:
    # The separating axis test with x, y and the segment's normal; `across` is twice an area, which avoids a
    # division.
    low_x, high_x = jnp.minimum(begin[..., 0], end[..., 0]), jnp.maximum(begin[..., 0], end[..., 0])
    low_y, high_y = jnp.minimum(begin[..., 1], end[..., 1]), jnp.maximum(begin[..., 1], end[..., 1])
    step_x, step_y = end[..., 0] - begin[..., 0], end[..., 1] - begin[..., 1]
    x_min, y_min, x_max, y_max = wall
    is_apart = (high_x < x_min) | (low_x > x_max) | (high_y < y_min) | (low_y > y_max)
    x, y = begin[..., 0] - 0.5 * (x_min + x_max), begin[..., 1] - 0.5 * (y_min + y_max)
    across = jnp.abs(step_x * y - step_y * x)
    widest = 0.5 * ((x_max - x_min) * jnp.abs(step_y) + (y_max - y_min) * jnp.abs(step_x))
    is_apart = is_apart | (across > widest)
    if may_leave:
        is_first = jnp.arange(begin.shape[0]) == 0
        is_apart = is_apart | (is_first & _leaves(begin[0], end[0], wall))
    return ~is_apart


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
