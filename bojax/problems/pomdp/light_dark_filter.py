"""The filter of the published results on Light Dark, which replaces some particles after each observation."""

import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Bool, Float, Key

from bojax.problems import particles
from bojax.problems.particles import Particles
from bojax.problems.pomdp.light_dark import LightDark


def update(
    problem: LightDark,
    key: Key[Array, ""],
    belief: Particles,
    action: Float[Array, "1"],
    observation: Float[Array, "1"],
    max_fraction: Float[Array, ""] | float = 0.05,
) -> tuple[Particles, Bool[Array, ""]]:
    """`particles.update`, then up to `max_fraction` of the particles, at random, are replaced.

    Fewer are replaced the nearer the largest likelihood is to the density at the mode of an observation
    from `observation`. As in the published code, a new particle is `observation` plus another observation
    from there, so that it is about twice `observation`; this changes the returns.
    """
    propagate_key, condition_key, choice_key, noise_key = jax.random.split(key, 4)
    moved, _ = particles.propagate(problem, propagate_key, belief, action)
    after, collapsed = particles.condition(problem, condition_key, belief, action, moved, observation)
    likelihood = jax.vmap(problem.log_likelihood, (None, 0, None, 0))
    largest = jnp.max(likelihood(observation, belief.states, action, moved.states))
    noise = problem.noise_at(observation)
    ratio = jnp.exp(largest - norm.logpdf(0.0, 0.0, noise[0]))
    count = after.states.shape[0]
    num_replaced = jnp.floor(max_fraction * jnp.maximum(0.0, 1.0 - ratio) * count)
    chosen = jax.random.permutation(choice_key, jnp.arange(count, dtype=noise.dtype)) < num_replaced
    drawn = 2.0 * observation[None] + noise[None] * jax.random.normal(noise_key, (count, 1), noise.dtype)
    replaced = jnp.clip(jnp.round(drawn), -problem.radius, problem.radius)
    states = jnp.where((chosen & ~collapsed)[:, None], replaced, after.states)
    return Particles(states, after.log_weights, after.terminal), collapsed
