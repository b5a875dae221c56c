"""Blocks with sharp edges on a floor: the props of Section 3.5.2."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Scalar
from typing_extensions import override

from bojax.fields.base import Field


class Blocks(Field):
    """Height of axis-parallel blocks on a floor at height 0; the highest of overlapping blocks counts.

    The field is piecewise constant; its gradient is 0 everywhere.

    Settings: `bojax.fields.settings.Blocks`.
    """

    boxes: Float[Array, "K 4"]
    heights: Float[Array, "K"]

    @override
    def __call__(self, x: Float[Array, "2"]) -> Scalar:
        is_on = self.covers(x)
        return jnp.max(jnp.where(is_on, self.heights, 0.0), initial=0.0)

    def covers(self, x: Float[Array, "2"]) -> Bool[Array, "K"]:
        """Whether a point lies on each of the blocks, borders included."""
        low, high = self.boxes[:, :2], self.boxes[:, 2:]
        return jnp.all((x[None] >= low) & (x[None] <= high), axis=-1)
