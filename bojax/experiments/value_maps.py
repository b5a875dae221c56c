"""Maps of the values Q and U of a learner over the observations (Figs. 5.6 and 5.7)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bojax.envs.spaces import Box, Space
from bojax.learning.base import Learner, LearnerState


def value_map(
    learner: Learner, state: LearnerState, observations: Space, actions: Space, resolution: int
) -> Float[Array, "2 *grid"]:
    """Q and U at the middle action.

    Of a discrete space, the values of every observation. Of a box, the values at the centres of
    `resolution` cells along each of the first two dimensions, with the others at their middle.
    """
    dtype = learner.exploration_weight.dtype
    if isinstance(actions, Box):
        action = 0.5 * (actions.low + actions.high)
    else:
        action = jnp.asarray(actions.num // 2, jnp.int32)
    values = jax.vmap(lambda observation: learner.values(state, observation, action))
    if not isinstance(observations, Box):
        return jnp.stack(values(jnp.arange(observations.num, dtype=jnp.int32)))
    axis = (jnp.arange(resolution, dtype=dtype) + 0.5) / resolution
    first, second = jnp.meshgrid(axis, axis, indexing="ij")
    unit = jnp.full((resolution, resolution, observations.num_dims), 0.5, dtype)
    unit = unit.at[..., 0].set(first)
    unit = unit.at[..., 1].set(second) if observations.num_dims > 1 else unit
    return jnp.stack(jax.lax.map(values, observations.from_unit(unit)))  # a row of cells at a time
