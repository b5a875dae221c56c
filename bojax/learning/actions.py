"""Some actions that stand for all, where a maximum or a mean over actions is wanted."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from bojax.envs.base import Action
from bojax.envs.spaces import Discrete, Space
from bojax.numerics.quasirandom import scrambled_halton


def even_actions(key: Key[Array, ""], number: int, space: Space) -> Action:
    """Actions that cover a box evenly, by a scrambled Halton sequence; of a discrete space, all of them."""
    if isinstance(space, Discrete):
        return jnp.arange(space.num, dtype=jnp.int32)
    return space.from_unit(scrambled_halton(key, number, space.num_dims, space.low.dtype))


def fresh_actions(key: Key[Array, ""], actions: Action, space: Space) -> Action:
    """As many uniform draws from a box; of a discrete space, all actions as ever."""
    if isinstance(space, Discrete):
        return actions
    return space.from_unit(jax.random.uniform(key, actions.shape, actions.dtype))
