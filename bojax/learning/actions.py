"""Finite sets of actions, over which learners maximise or average."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from bojax.envs.base import Action
from bojax.envs.spaces import Box, Discrete, Space
from bojax.numerics.quasirandom import scrambled_halton


def even_actions(key: Key[Array, ""], number: int, space: Space) -> Action:
    """`number` points of a scrambled Halton sequence in a box; all actions of a discrete space."""
    if isinstance(space, Discrete):
        return jnp.arange(space.num, dtype=jnp.int32)
    return space.from_unit(scrambled_halton(key, number, space.num_dims, space.low.dtype))


def grid_actions(per_dimension: int, space: Space) -> Action:
    """A regular grid over a box, bounds included; all actions of a discrete space."""
    if isinstance(space, Discrete):
        return jnp.arange(space.num, dtype=jnp.int32)
    points = jnp.linspace(0.0, 1.0, per_dimension, dtype=space.low.dtype)
    grid = jnp.stack(jnp.meshgrid(*[points] * space.num_dims, indexing="ij"), axis=-1)
    return space.from_unit(grid.reshape(-1, space.num_dims))


def nearest_action(actions: Action, action: Action) -> Int[Array, ""]:
    """Index of the one of `actions`, `[J, ...]`, that is nearest to `action` in Euclidean distance."""
    difference = (actions - action[None]).reshape(len(actions), -1)
    return jnp.argmin(jnp.sum(difference**2, axis=1)).astype(jnp.int32)


def uniform_actions(key: Key[Array, ""], actions: Action, space: Space) -> Action:
    """Uniform draws from a box, as many as there are `actions`; of a discrete space, `actions` unchanged."""
    if isinstance(space, Discrete):
        return actions
    return space.from_unit(jax.random.uniform(key, actions.shape, actions.dtype))


def refined_action(
    scores: Callable[[Action], Float[Array, "J"]], action: Action, space: Box, spacing: Array, steps: int
) -> Action:
    """Pattern search: each step moves to the best of the action and two neighbours along each dimension.

    Args:
        scores: Objective at a set of actions, `[J, A] -> [J]`.
        action: Action to start from.
        space: Bounds of actions.
        spacing: Distance of the neighbours in the first step, `[A]`; it is halved in every further step.
        steps: Number of steps.
    """

    def improve(i, action):
        step = (spacing * 0.5**i)[None, :] * jnp.concatenate(
            [jnp.eye(space.num_dims), -jnp.eye(space.num_dims), jnp.zeros((1, space.num_dims))]
        ).astype(action.dtype)
        around = jnp.clip(action[None, :] + step, space.low[None, :], space.high[None, :])
        return around[jnp.argmax(scores(around))]

    return jax.lax.fori_loop(0, steps, improve, action)
