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
    row = rows.pack(transition, jnp.asarray(0.75, jnp.float32), jnp.asarray(-4.5, jnp.float32), frame)
    assert row.shape == (rows.width,)
    back, expected = rows.unpack(row[None])
    for name, value in vars(transition).items():
        np.testing.assert_array_equal(getattr(back, name)[0], value)
    assert back.action.dtype == jnp.int32 and expected[0] == 0.75
    table = rows.table(row[None], jnp.ones(1, jnp.int32), jnp.full(1, 3, jnp.int32))
    assert (table["episode"][0], table["step"][0], table["accumulated_reward"][0]) == (3, 1, -4.5)
    np.testing.assert_array_equal(
        [table[f"qpos_{i}"][0] for i in range(frame_size)], np.arange(frame_size) + 7.0
    )
    names = [column.name for column in rows.columns]
    assert sum(name.startswith("qpos_") for name in names) == frame_size


def test_the_steps_of_successive_episodes_are_numbered_in_each():
    rows = StepRows(BOX, Discrete(5), 0, jnp.dtype("float32"))
    table = rows.table(
        jnp.zeros((8, rows.width), jnp.float32),
        jnp.asarray([2, 3, 1, 0], jnp.int32),
        jnp.asarray([4, 5, 6, 0], jnp.int32),
    )
    is_row = np.asarray(table["valid"])
    np.testing.assert_array_equal(is_row, [True] * 6 + [False] * 2)
    np.testing.assert_array_equal(table["episode"][is_row], [4, 4, 5, 5, 5, 6])
    np.testing.assert_array_equal(table["step"][is_row], [1, 2, 1, 2, 3, 1])
    np.testing.assert_array_equal(table["done"][is_row], [False, True, False, False, True, True])
