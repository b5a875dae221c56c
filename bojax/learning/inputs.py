"""Observations and actions as inputs of neural networks."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Discrete, Space


def input_size(space: Space) -> int:
    """Number of inputs of an element of a space."""
    return space.num if isinstance(space, Discrete) else space.num_dims


def as_inputs(space: Space, values: Observation | Action, dtype: jnp.dtype) -> Float[Array, "*N I"]:
    """Elements of a space with the bounds mapped to -1 and 1, or one-hot elements of a discrete space."""
    if isinstance(space, Discrete):
        return jax.nn.one_hot(values, space.num, dtype=dtype)
    return 2.0 * space.to_unit(values).astype(dtype) - 1.0
