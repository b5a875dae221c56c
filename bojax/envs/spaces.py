"""Spaces of observations and actions: a box of vectors, or a finite set."""

from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key


class Box(eqx.Module):
    """Vectors between two bounds. Vectors outside the bounds are accepted, and are not clipped.

    Attributes:
        low: Lower bound of each dimension.
        high: Upper bound of each dimension.
    """

    low: Float[Array, "D"]
    high: Float[Array, "D"]

    @property
    def num_dims(self) -> int:
        """Number of dimensions."""
        return self.low.shape[0]

    @property
    def example(self) -> Float[Array, "D"]:
        """Zeros with the shape and dtype of a vector."""
        return jnp.zeros_like(self.low)

    @property
    def num_units(self) -> int:
        """Number of inputs or outputs of a neural network for a vector."""
        return self.num_dims

    def inputs(self, x: Float[Array, "*N D"], dtype: jnp.dtype) -> Float[Array, "*N D"]:
        """Inputs of a neural network: the bounds mapped to -1 and 1."""
        return 2.0 * self.to_unit(x).astype(dtype) - 1.0

    def sample(self, key: Key[Array, ""]) -> Float[Array, "D"]:
        """A uniform draw."""
        return self.from_unit(jax.random.uniform(key, self.low.shape, self.low.dtype))

    def to_unit(self, x: Float[Array, "*N D"]) -> Float[Array, "*N D"]:
        """Map the bounds to 0 and 1."""
        low, high = (jnp.broadcast_to(bound, x.shape) for bound in (self.low, self.high))
        return (x - low) / (high - low)

    def from_unit(self, u: Float[Array, "*N D"]) -> Float[Array, "*N D"]:
        """Map 0 and 1 to the bounds."""
        low, high = (jnp.broadcast_to(bound, u.shape) for bound in (self.low, self.high))
        return low + u * (high - low)


class Discrete(eqx.Module):
    """The integers 0, ..., num - 1.

    Attributes:
        num: Number of elements.
    """

    num: int = eqx.field(static=True)

    @property
    def num_dims(self) -> int:
        """Number of dimensions of the result of `to_unit`."""
        return 1

    @property
    def example(self) -> Int[Array, ""]:
        """The first element."""
        return jnp.zeros((), jnp.int32)

    @property
    def num_units(self) -> int:
        """Number of inputs or outputs of a neural network for an element."""
        return self.num

    def inputs(self, x: Int[Array, "*N"], dtype: jnp.dtype) -> Float[Array, "*N I"]:
        """Inputs of a neural network: one-hot elements."""
        return jax.nn.one_hot(x, self.num, dtype=dtype)

    def sample(self, key: Key[Array, ""]) -> Int[Array, ""]:
        """A uniform draw."""
        return jax.random.randint(key, (), 0, self.num, jnp.int32)

    def to_unit(self, x: Int[Array, "*N"]) -> Float[Array, "*N 1"]:
        """Map the first element to 0 and the last one to 1."""
        return (x / max(self.num - 1, 1)).astype(jnp.result_type(float))[..., None]


Space: TypeAlias = Box | Discrete
