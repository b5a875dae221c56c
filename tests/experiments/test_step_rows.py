"""Steps kept as rows of numbers."""

import jax.numpy as jnp
import numpy as np
import pytest

from bojax.envs.spaces import Box, Discrete
from bojax.experiments.step_rows import StepRows
from bojax.learning.base import Transition

BOX = Box(jnp.asarray([-1.0, 0.0], jnp.float32), jnp.asarray([1.0, 10.0], jnp.float32))


@pytest.mark.parametrize("frame_size", [0, 3])
def test_a_row_holds_a_step_and_gives_it_back(frame_size):
    rows = StepRows(BOX, Discrete(5), frame_size, jnp.dtype("float32"))
    transition = Transition(
        observation=jnp.asarray([0.5, 2.0], jnp.float32),
        action=jnp.asarray(3, jnp.int32),
        reward=jnp.asarray(-1.5, jnp.float32),
        next_observation=jnp.asarray([0.25, 9.0], jnp.float32),
        terminated=jnp.asarray(True),
    )
    frame = jnp.arange(frame_size, dtype=jnp.float32) + 7.0 if frame_size else None
    row = rows.pack(transition, jnp.asarray(0.75, jnp.float32), frame)
    assert row.shape == (rows.width,)
    back, expected, frames = rows.unpack(row[None])
    for name, value in vars(transition).items():
        np.testing.assert_array_equal(getattr(back, name)[0], value)
    assert back.action.dtype == jnp.int32 and expected[0] == 0.75
    np.testing.assert_array_equal(frames[0], np.arange(frame_size) + 7.0)
    names = [column.name for column in rows.columns]
    assert sum(name.startswith("qpos_") for name in names) == frame_size
