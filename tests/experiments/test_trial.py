"""Steps kept as rows of numbers, and what counts as outside the declared bounds."""

import jax.numpy as jnp
import numpy as np
import pytest

from bojax.envs.spaces import Box, Discrete
from bojax.experiments.trial import StepRows, is_outside
from bojax.learning.base import Experience

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
def test_a_vector_is_outside_beyond_its_bounds_and_rounding(observation, expected):
    assert bool(is_outside(BOX, jnp.asarray(observation, jnp.float32))) == expected


@pytest.mark.parametrize(("number", "expected"), [(0, False), (3, False), (4, True), (-1, True)])
def test_a_number_is_outside_where_there_is_no_such_state(number, expected):
    assert bool(is_outside(Discrete(4), jnp.asarray(number, jnp.int32))) == expected


@pytest.mark.parametrize("frame_size", [0, 3])
def test_a_row_holds_a_step_and_gives_it_back(frame_size):
    rows = StepRows(BOX, Discrete(5), frame_size, jnp.dtype("float32"))
    step = Experience(
        observation=jnp.asarray([0.5, 2.0], jnp.float32),
        action=jnp.asarray(3, jnp.int32),
        reward=jnp.asarray(-1.5, jnp.float32),
        next_observation=jnp.asarray([0.25, 9.0], jnp.float32),
        terminated=jnp.asarray(True),
    )
    frame = jnp.arange(frame_size, dtype=jnp.float32) + 7.0 if frame_size else None
    row = rows.pack(step, jnp.asarray(0.75, jnp.float32), frame)
    assert row.shape == (rows.width,)
    back, expected, frames = rows.unpack(row[None])
    for name, value in vars(step).items():
        np.testing.assert_array_equal(getattr(back, name)[0], value)
    assert back.action.dtype == jnp.int32 and expected[0] == 0.75
    np.testing.assert_array_equal(frames[0], np.arange(frame_size) + 7.0)
    names = [column.name for column in rows.columns]
    assert sum(name.startswith("qpos_") for name in names) == frame_size
