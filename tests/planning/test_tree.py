"""The arrays of a search tree."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.planning.tree import write_row

ROWS = np.arange(24.0).reshape(3, 4, 2)
NEW = -np.arange(1.0, 7.0).reshape(3, 2)


@pytest.mark.parametrize("rows_differ", [True, False])
@pytest.mark.parametrize("index_differs", [True, False])
@pytest.mark.parametrize("row_differs", [True, False])
def test_a_row_is_written_in_every_lane(rows_differ, index_differs, row_differs):
    differ = [rows_differ, index_differs, row_differs]
    index = np.array([3, 0, 2], np.int32)
    arguments = [x if d else x[0] for x, d in zip((ROWS, index, NEW), differ, strict=True)]
    if any(differ):
        axes = [0 if d else None for d in differ]
        written = jax.jit(jax.vmap(write_row, axes))(*map(jnp.asarray, arguments))
    else:
        written = jnp.broadcast_to(write_row(*map(jnp.asarray, arguments)), ROWS.shape)
    for lane in range(3):
        rows, at, row = (x[lane] if d else x for x, d in zip(arguments, differ, strict=True))
        expected = np.array(rows)
        expected[at] = row
        np.testing.assert_array_equal(written[lane], expected)


def test_lanes_that_write_at_the_same_index_need_no_scatter():
    program = jax.make_jaxpr(jax.vmap(write_row, (0, None, 0)))(ROWS, jnp.asarray(1, jnp.int32), NEW)
    assert "dynamic_update_slice" in str(program)
    assert "scatter" not in str(program)
