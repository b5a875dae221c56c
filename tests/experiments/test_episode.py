"""Which observations are outside the declared bounds."""

import jax.numpy as jnp
import pytest

from bojax.envs.spaces import Box, Discrete
from bojax.experiments.episode import outside_bounds

BOX = Box(jnp.asarray([-1.0, 0.0], jnp.float32), jnp.asarray([1.0, 10.0], jnp.float32))


@pytest.mark.parametrize(
    ("observation", "expected"),
    [
        ((0.0, 5.0), False),
        ((1.0, 10.0), False),
        ((1.0001, 10.0), False),  # rounding, in units of the range
        ((1.01, 5.0), True),
        ((0.0, -0.01), True),
    ],
)
def test_a_vector_outside_bounds_beyond_its_bounds_and_rounding(observation, expected):
    assert bool(outside_bounds(BOX, jnp.asarray(observation, jnp.float32))) == expected


@pytest.mark.parametrize(("number", "expected"), [(0, False), (3, False), (4, True), (-1, True)])
def test_a_number_outside_bounds_where_there_is_no_such_state(number, expected):
    assert bool(outside_bounds(Discrete(4), jnp.asarray(number, jnp.int32))) == expected
