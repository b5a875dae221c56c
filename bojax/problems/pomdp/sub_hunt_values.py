"""The values of Sub Hunt with states observed, by value iteration over all its states."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bojax.problems.pomdp.sub_hunt import SubHunt, table_index


def solve(problem: SubHunt) -> Float[Array, "X Y X Y 4 2 6"]:
    """Optimal value of each action with states observed, by value iteration.

    The target advances at every step, so that `size` sweeps are exact.
    """
    shape = (*(problem.size,) * 4, 4, 2)
    first = jnp.asarray([1, 1, 1, 1, 0, 0], jnp.int32)
    index = jnp.arange(math.prod(shape), dtype=jnp.int32)
    states = jnp.stack(jnp.unravel_index(index, shape), axis=1) + first[None]
    dtype = problem.discount.dtype

    def action_value(
        values: Float[Array, "X Y X Y 4 2"], state: Int[Array, "6"], action: Int[Array, ""]
    ) -> Float[Array, ""]:
        own, targets, aware, kill = problem.outcomes(state, action)

        def value(target: Int[Array, "2"]) -> Float[Array, ""]:
            after = jnp.concatenate([own, target, state[4:5], aware[None]])
            return jnp.where(problem.has_escaped(after), 0.0, values[table_index(after)])

        expected = jnp.sum(problem.probabilities() * jax.vmap(value)(targets))
        return kill * problem.kill_reward + (1.0 - kill) * problem.discount * expected

    def all_values(values: Float[Array, "X Y X Y 4 2"]) -> Float[Array, "X Y X Y 4 2 6"]:
        each = jax.vmap(jax.vmap(action_value, (None, None, 0)), (None, 0, None))
        return each(values, states, jnp.arange(6, dtype=jnp.int32)).reshape(*shape, 6)

    def sweep(_: Int[Array, ""], found: Float[Array, "X Y X Y 4 2 6"]) -> Float[Array, "X Y X Y 4 2 6"]:
        return all_values(jnp.max(found, axis=-1))

    return jax.lax.fori_loop(0, problem.size, sweep, jnp.zeros((*shape, 6), dtype))
