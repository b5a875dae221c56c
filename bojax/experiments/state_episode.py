"""An episode of a state problem: a policy acts on a belief of particles, with the true state hidden."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.problems import particles
from bojax.problems.particles import Particles
from bojax.problems.state_space import StateProblem

Policy = Callable[[Key[Array, ""], Particles], Float[Array, "K"]]
"""An action for a belief."""

Update = Callable[..., tuple[Particles, Bool[Array, ""]]]
"""A filter with the arguments of `particles.update`."""


class _Carry(NamedTuple):
    step: Int[Array, ""]
    state: Float[Array, "D"]
    belief: Particles
    discounted_return: Float[Array, ""]
    collapsed: Int[Array, ""]
    done: Bool[Array, ""]


def episode(
    problem: StateProblem,
    policy: Policy,
    key: Key[Array, ""],
    num_particles: int,
    update: Update = particles.update,
) -> tuple[Float[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """The discounted return, the number of steps, and how often the belief has collapsed.

    The world and the policy draw from separate streams, so that policies can be compared in pairs.
    """
    world_key, policy_key, state_key, belief_key = jax.random.split(key, 4)

    def advance(now: _Carry) -> _Carry:
        act_key, update_key = jax.random.split(jax.random.fold_in(policy_key, now.step))
        step_key, observe_key = jax.random.split(jax.random.fold_in(world_key, now.step))
        action = policy(act_key, now.belief)
        state, reward, terminated = problem.step(step_key, now.state, action)
        observation = problem.observe(observe_key, now.state, action, state)
        belief, has_collapsed = update(problem, update_key, now.belief, action, observation)
        return _Carry(
            now.step + 1,
            state,
            belief,
            now.discounted_return + problem.discount ** now.step.astype(reward.dtype) * reward,
            now.collapsed + (has_collapsed & ~terminated).astype(jnp.int32),
            terminated | (now.step + 1 >= problem.max_steps),
        )

    zero = jnp.zeros((), jnp.int32)
    belief = particles.initial(problem, belief_key, num_particles)
    nothing = jnp.zeros_like(problem.discount)
    start = _Carry(zero, problem.initial(state_key), belief, nothing, zero, jnp.zeros((), bool))
    end = jax.lax.while_loop(lambda now: ~now.done, advance, start)
    return end.discounted_return, end.step, end.collapsed
