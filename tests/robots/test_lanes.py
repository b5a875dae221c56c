"""Lanes and loops of the implementations that step all lanes in one call."""

import functools

import jax
import numpy as np
import pytest

from bojax.numerics.lanes import LANES as AXIS
from tests.robots.test_simulator import IMPLS, LANES, driven, simulator

pytestmark = [
    pytest.mark.bits,
    pytest.mark.parametrize("impl", [impl for impl in IMPLS if impl != "jax"]),
]

STEPS = 5


@functools.cache
def start():
    """States of `LANES` hoppers, most of them in contact with the floor, and their controls."""
    qpos, qvel, controls = driven("hopper")
    return qpos, qvel, controls[:, :STEPS]


def scanned(impl, qpos, qvel, controls):
    robot = simulator("hopper", impl)
    state = robot.state(qpos, qvel)
    return jax.lax.scan(lambda state, control: (robot.advance(state, control), None), state, controls)[0]


def looped(impl, qpos, qvel, controls):
    robot = simulator("hopper", impl)

    def body(carry):
        number, state = carry
        return number + 1, robot.advance(state, controls[number])

    return jax.lax.while_loop(lambda carry: carry[0] < STEPS, body, (0, robot.state(qpos, qvel)))[1]


@functools.cache
def expected(impl):
    return jax.jit(jax.vmap(functools.partial(scanned, impl), axis_name=AXIS))(*start())


def assert_same(found, reference):
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(reference), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("width", [1, 2, 5])
def test_a_lane_does_not_depend_on_their_number(impl, width):
    found = jax.jit(jax.vmap(functools.partial(scanned, impl)))(*(part[:width] for part in start()))
    assert_same(found, jax.tree.map(lambda leaf: leaf[:width], expected(impl)))


def test_vmap_is_a_loop_over_single_robots(impl):
    one = jax.jit(functools.partial(scanned, impl))
    found = [one(*lane) for lane in zip(*start(), strict=True)]
    assert_same(jax.tree.map(lambda *leaves: np.stack(leaves), *found), expected(impl))


def test_lanes_of_lanes_are_lanes(impl):
    halves = [part.reshape(2, LANES // 2, *part.shape[1:]) for part in start()]
    found = jax.jit(jax.vmap(jax.vmap(functools.partial(scanned, impl))))(*halves)
    assert_same(jax.tree.map(lambda leaf: leaf.reshape(LANES, -1), found), expected(impl))


def test_a_while_loop_is_a_scan(impl):
    assert_same(jax.jit(jax.vmap(functools.partial(looped, impl)))(*start()), expected(impl))


def test_lanes_may_share_their_controls(impl):
    qpos, qvel, controls = start()
    shared = jax.vmap(functools.partial(scanned, impl), in_axes=(0, 0, None))
    found = jax.jit(shared)(qpos, qvel, controls[2])
    assert_same(jax.tree.map(lambda leaf: leaf[2], found), jax.tree.map(lambda leaf: leaf[2], expected(impl)))


def test_nothing_of_a_call_is_left_for_the_next(impl):
    """All calls share the buffers of C MuJoCo."""
    qpos, qvel, controls = start()
    before = expected(impl)
    advance = jax.jit(jax.vmap(functools.partial(scanned, impl)))
    assert np.isnan(advance(qpos, np.full_like(qvel, np.nan), controls).qpos).all()
    assert_same(advance(*start()), before)
