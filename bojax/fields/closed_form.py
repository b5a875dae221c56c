"""Fields in closed form; the thesis shows its fields only as pictures (Figs. 3.1, 3.2, 4.3)."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Scalar
from typing_extensions import override

from bojax.fields.base import Field


class Bumps(Field):
    """A sum of Gaussian bumps; a bump of negative height is a pit.

    The steepest slope of a bump is 0.61 |height| / width, at a distance of one width from its centre.

    Settings: `bojax.fields.settings.Bumps`.
    """

    heights: Float[Array, "K"]
    centres: Float[Array, "K 2"]
    widths: Float[Array, "K"]

    @override
    def __call__(self, x: Float[Array, "2"]) -> Scalar:
        squared = jnp.sum((x[None, :] - self.centres) ** 2, axis=-1)
        return jnp.sum(self.heights * jnp.exp(-0.5 * squared / self.widths**2))


class Step(Field):
    """A smooth step across a straight line: `height` tanh(d / width), where d is the signed distance from it.

    Settings: `bojax.fields.settings.Step`.
    """

    point: Float[Array, "2"]
    direction: Float[Array, ""]
    height: Float[Array, ""]
    width: Float[Array, ""]

    @override
    def __call__(self, x: Float[Array, "2"]) -> Scalar:
        offset = x - self.point
        across = offset[0] * jnp.cos(self.direction) + offset[1] * jnp.sin(self.direction)
        return self.height * jnp.tanh(across / self.width)


class Blocks(Field):
    """Height of axis-parallel blocks with sharp edges on a floor at height 0 (the props of Section 3.5.2).

    The highest of overlapping blocks counts. The field is piecewise constant; its gradient is 0 everywhere.

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
