"""Blocks against a loop over them, and what settings of them may not be."""

import numpy as np
import pydantic
import pytest

from bojax.fields import settings as fields
from bojax.fields.closed_form import Blocks
from tests.arrays import f64

BOXES, HEIGHTS = [[0.0, 0.0, 1.0, 2.0], [0.5, 1.0, 3.0, 1.5]], [0.3, 0.7]


def test_the_highest_block_over_a_point_counts():
    xs = np.random.default_rng(0).uniform(-1.0, 4.0, (400, 2))
    expected = [
        max(
            [0.0, *(h for (a, b, c, d), h in zip(BOXES, HEIGHTS, strict=True) if a <= x <= c and b <= y <= d)]
        )
        for x, y in xs
    ]
    field = Blocks(f64(BOXES), f64(HEIGHTS))
    np.testing.assert_array_equal(field.values(f64(xs)), expected)
    assert set(expected) == {0.0, *HEIGHTS}
    np.testing.assert_array_equal(field.gradients(f64(xs)), 0.0)


def test_every_block_has_a_height():
    with pytest.raises(pydantic.ValidationError, match="the same number of each"):
        fields.Blocks(boxes=BOXES, heights=HEIGHTS[:1])
    with pytest.raises(pydantic.ValidationError, match="x_min < x_max"):
        fields.Blocks(boxes=[[1.0, 0.0, 0.0, 1.0]], heights=[1.0])
