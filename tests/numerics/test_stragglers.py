"""Loops whose last lanes run alone, against the same loops in Python."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.lanes import LANES, any_lane
from bojax.numerics.stragglers import LEAST, SHARE, while_going


def collatz(start: int, growth: int) -> tuple[int, int, int]:
    """Last value, number of steps and sum of the numbers of the steps of a Collatz sequence."""
    value, turns, numbers = start, 0, 0
    while value > 1:
        value = growth * value + 1 if value % 2 else value // 2
        numbers += turns
        turns += 1
    return value, turns, numbers


def lane(start, growth):
    """The same for a lane; a lane that has ended is left as it is."""

    def step(number, state):
        value, turns, numbers = state
        going = value > 1
        following = jnp.where(value % 2 == 1, growth * value + 1, value // 2)
        return (
            jnp.where(going, following, value),
            turns + going.astype(int),
            numbers + jnp.where(going, number, 0).astype(int),
        )

    zero = jnp.zeros((), int)
    return while_going(lambda state: state[0] > 1, step, (start, zero, zero))


STARTS = {
    "lengths differ": np.arange(1, LEAST + 37),
    "one lane goes on": np.array([1] * LEAST + [27]),
    "all end together": np.full(LEAST, 27),
    "no lane begins": np.ones(LEAST, int),
    "few lanes": np.arange(1, 10),
}


@pytest.mark.parametrize("starts", STARTS.values(), ids=list(STARTS))
@pytest.mark.parametrize("is_own", [True, False], ids=["growth of each lane", "one growth"])
def test_each_lane_is_that_of_a_loop_of_its_own(starts, is_own):
    growth, axis = (jnp.full(len(starts), 3), 0) if is_own else (jnp.asarray(3), None)
    found = jax.jit(jax.vmap(lane, (0, axis), axis_name=LANES))(jnp.asarray(starts), growth)
    np.testing.assert_array_equal(np.stack(found, axis=1), [collatz(int(start), 3) for start in starts])
    assert [int(x) for x in lane(jnp.asarray(27), jnp.asarray(3))] == list(collatz(27, 3))  # without a batch


@pytest.mark.parametrize(("lanes", "gathered"), [(LEAST, LEAST // SHARE), (LEAST - 1, 0)])
def test_the_last_lanes_are_gathered_in_a_large_batch_alone(lanes, gathered):
    traced = jax.make_jaxpr(jax.vmap(lane, (0, None), axis_name=LANES))(jnp.ones(lanes, int), jnp.asarray(3))
    loops = [equation for equation in traced.jaxpr.eqns if equation.primitive.name == "while"]
    widths = [{x.aval.shape[0] for x in loop.outvars if x.aval.shape} for loop in loops]
    assert widths == [{lanes}] + ([{gathered}] if gathered else [])


def test_a_step_that_asks_all_lanes_sees_those_that_go_on():
    """`any_lane` in the step of a gathered loop is about the lanes that go on."""

    def countdown(length, is_marked):
        def step(_, state):
            left, seen = state
            seen = seen + (any_lane(is_marked & (left > 0)) & (left > 0)).astype(int)
            return jnp.maximum(left - 1, 0), seen

        return while_going(lambda state: state[0] > 0, step, (length, jnp.zeros((), int)))

    lengths = jnp.ones(LEAST, int).at[0].set(5).at[1].set(3)
    marked = jnp.zeros(LEAST, bool).at[1].set(True)
    left, seen = jax.vmap(countdown, axis_name=LANES)(lengths, marked)
    np.testing.assert_array_equal(left, np.zeros(LEAST))
    assert int(jnp.asarray(seen)[0]) == 3  # while lane 1 is going too
