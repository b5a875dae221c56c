"""How far a robot comes: line pieces and rectangles against dense sampling and exact cases."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.problems.walls import drive_until_blocked, is_free
from tests.arrays import f64
from tests.reference.monitoring import segments_touch_boxes

DOMAIN = (0.0, 0.0, 4.0, 3.0)
WALL = (1.0, 1.0, 2.0, 1.5)


@jax.jit
def drive(start, poses, domain, walls):
    return drive_until_blocked(jnp.concatenate([start[None], poses]), domain, walls)


@jax.jit
@jax.vmap
def hits(begin, end, walls):
    """Whether a line piece is stopped by one of its walls, in a domain without end."""
    domain = jnp.asarray([-jnp.inf, -jnp.inf, jnp.inf, jnp.inf])
    pose = jnp.concatenate([begin, jnp.zeros(1)])
    trajectory = jnp.stack([pose, jnp.concatenate([end, jnp.zeros(1)])])
    return drive_until_blocked(trajectory, domain, walls).collided


def piece(begin, end, wall=WALL, domain=DOMAIN):
    """One straight drive: whether it is (driven, stopped by the wall, stopped by the border)."""
    walls = None if wall is None else f64([wall])
    driven = drive(f64([*begin, 0.0]), f64([[*end, 0.0]]), f64(domain), walls)
    return bool(driven.is_driven[0]), bool(driven.collided), bool(driven.exited)


FREE, HIT, OUT = (True, False, False), (False, True, False), (False, False, True)


def random_pieces(num=3000):
    rng = np.random.default_rng(0)
    begin = rng.uniform(-1.0, 1.0, (num, 2))
    end = begin + rng.normal(size=(num, 2)) * rng.choice([0.02, 0.3, 1.0], (num, 1))
    end[::10, 0] = begin[::10, 0]  # parallel to an axis
    end[5::10, 1] = begin[5::10, 1]
    corner = begin + rng.normal(scale=0.3, size=(num, 2))
    boxes = np.concatenate([corner, corner + rng.choice([1e-3, 0.1, 0.6], (num, 2))], axis=1)
    return begin, end, boxes


def leaves(begin, end, boxes):
    """Whether pieces begin inside of a rectangle and end beyond the face that is nearest to the begin."""
    gaps, beyond = (
        np.concatenate([point - boxes[:, :2], boxes[:, 2:] - point], axis=1) for point in (begin, end)
    )
    nearest = np.argmin(gaps, axis=1)
    return (gaps > 0.0).all(axis=1) & (beyond[np.arange(len(beyond)), nearest] < 0.0)


def test_it_is_the_rectangle_that_no_axis_separates():
    begin, end, boxes = random_pieces()
    found = hits(f64(begin), f64(end), f64(boxes[:, None]))
    expected = np.array(
        [
            segments_touch_boxes(b[None], e[None], box[None])[0, 0]
            for b, e, box in zip(begin, end, boxes, strict=True)
        ]
    )
    np.testing.assert_array_equal(found, expected & ~leaves(begin, end, boxes))


@pytest.mark.parametrize(
    ("begin", "end", "expected"),
    [
        ((0.5, 1.25), (2.5, 1.25), HIT),  # through the wall, with both ends outside
        ((1.5, 0.5), (1.5, 2.0), HIT),
        ((0.5, 1.25), (1.0, 1.25), HIT),  # ends on its face
        ((0.5, 1.25), (0.999, 1.25), FREE),
        ((0.5, 1.0), (2.5, 1.0), HIT),  # slides along a face
        ((0.5, 0.999), (2.5, 0.999), FREE),  # parallel beside it
        ((0.0, 1.5), (0.9, 1.5), FREE),  # on the line of a face, not up to it
        ((0.5, 2.0), (1.5, 1.0), HIT),  # through a corner's interior
        ((0.5, 1.5), (1.5, 0.5), HIT),  # touches the corner (1, 1) alone
        ((0.5, 1.49), (1.49, 0.5), FREE),  # just misses it
        ((1.5, 1.25), (1.5, 1.25), HIT),  # stands in it
        ((0.5, 0.5), (0.5, 0.5), FREE),  # stands beside it
        ((1.0, 1.25), (0.5, 1.25), HIT),  # from a face away from the wall: touching is hitting
        ((1.001, 1.25), (0.5, 1.25), FREE),  # from a little inside out by the nearest face
        ((1.001, 1.25), (0.5, 1.9), FREE),
        ((1.999, 1.25), (2.001, 1.25), FREE),
        ((1.5, 1.001), (1.5, 0.5), FREE),
        ((1.5, 1.499), (1.5, 2.0), FREE),
        ((1.001, 1.25), (1.0, 1.25), HIT),  # only up to that face
        ((1.001, 1.25), (1.5, 1.25), HIT),  # into the wall
        ((1.001, 1.25), (2.5, 1.25), HIT),  # out by the face across
        ((1.001, 1.4), (1.1, 2.0), HIT),  # or beside it
    ],
)
def test_pieces_at_the_edges_of_a_wall(begin, end, expected):
    assert piece(begin, end) == expected


def test_pieces_at_the_border():
    for begin, end, expected in (
        ((0.0, 0.0), (4.0, 3.0), FREE),  # the border belongs to the domain
        ((0.0, 1.0), (0.0, 2.0), FREE),  # along it
        ((0.0, 1.0), (-1e-9, 1.0), OUT),
        ((0.0, 1.0), (1.0, 3.0), FREE),
        ((3.0, 2.0), (4.5, 2.0), OUT),
    ):
        assert piece(begin, end, wall=None) == expected
    assert piece((1.5, 2.0), (1.5, -1.0)) == HIT  # a wall on the way out


def test_a_robot_that_takes_itself_to_be_inside_a_wall_leaves_it_but_hits_the_next():
    wall, other = (1.0, 1.0, 2.0, 1.5), (0.5, 1.0, 0.7, 1.5)
    start, path = (
        f64([1.01, 1.2, 0.0]),
        f64([[0.9, 1.2, 0.0], [0.8, 1.2, 0.0], [0.9, 1.2, 0.0], [1.2, 1.2, 0.0]]),
    )
    driven = drive(start, path, f64(DOMAIN), f64([wall, other]))
    np.testing.assert_array_equal(driven.is_driven, [True, True, True, False])
    assert driven.collided
    away = drive(start, f64([[0.4, 1.2, 0.0]]), f64(DOMAIN), f64([wall, other]))
    assert away.collided and not np.any(away.is_driven)


def test_free_points_are_in_the_domain_and_in_no_wall():
    rng = np.random.default_rng(1)
    xs, walls = rng.uniform(-1.0, 5.0, (2000, 2)), np.array([WALL, (3.0, 0.0, 3.2, 2.0)])
    inside = np.all((xs >= DOMAIN[:2]) & (xs <= DOMAIN[2:]), axis=-1)
    walled = [np.all((xs >= wall[:2]) & (xs <= wall[2:]), axis=-1) for wall in walls]
    np.testing.assert_array_equal(is_free(f64(xs), f64(DOMAIN), f64(walls)), inside & ~np.any(walled, axis=0))
    np.testing.assert_array_equal(is_free(f64(xs), f64(DOMAIN), None), inside)
