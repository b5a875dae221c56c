"""Policies without search: what a planner with a belief of particles must beat, and what rollouts follow.

Sources: Sunberg and Kochenderfer (ICAPS 2018), with its code; QMDP: Littman, Cassandra, Kaelbling (1995).
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from bojax.numerics.linalg import matmul
from bojax.problems.particles import Particles
from bojax.problems.pomdp.light_dark import LightDark
from bojax.problems.pomdp.pomdp_lander import PomdpLander
from bojax.problems.pomdp.sub_hunt import PING, SubHunt
from bojax.problems.pomdp.vdp_tag import VdpTag


def to_next_ml(problem: VdpTag, key: Key[Array, ""], belief: Particles) -> Float[Array, "2"]:
    """Move towards the most likely next position of a random particle's target; never look."""
    return _towards_next(problem, belief.sample(key), jnp.zeros((), belief.states.dtype))


def to_next_mean(problem: VdpTag, key: Key[Array, ""], belief: Particles) -> Float[Array, "2"]:
    """Move towards the next position of the mean target, never look: published searches try it first."""
    return _towards_next(problem, belief.mean, jnp.zeros((), belief.states.dtype))


def manage_uncertainty(problem: VdpTag, key: Key[Array, ""], belief: Particles) -> Float[Array, "2"]:
    """Move towards the next position of the mean target; look if it is uncertain.

    It is where the root of the determinant of its covariance is above 0.01.
    """
    determinant = jnp.linalg.det(belief.covariance[2:, 2:])
    look = jnp.sqrt(jnp.maximum(determinant, 0.0)) > 0.01
    return _towards_next(problem, belief.mean, look.astype(belief.states.dtype))


def _towards_next(problem: VdpTag, state: Float[Array, "4"], look: Float[Array, ""]) -> Float[Array, "2"]:
    offset = problem.drift(state[2:]) - state[:2]
    angle = jnp.arctan2(offset[1], offset[0])
    return jnp.stack([jnp.where(angle < 0.0, angle + 2.0 * jnp.pi, angle), look])


def qmdp(problem: LightDark | SubHunt, key: Key[Array, ""], belief: Particles) -> Float[Array, "1"]:
    """Take the action with the best mean value, as if the state were observed from the next step on."""
    values = matmul(jnp.exp(belief.log_weights), jax.vmap(problem.values_at)(belief.states))
    return problem.actions.values[jnp.argmax(values)]


def localise_first(
    problem: LightDark, key: Key[Array, ""], belief: Particles, threshold: Float[Array, ""] | float = 0.1
) -> Float[Array, "1"]:
    """Go to the light by moves of 10 and 1, until the belief's standard deviation is small; then QMDP.

    It acts with standard deviations up to `threshold`.
    """
    offset = belief.mean - problem.light
    length = jnp.where(jnp.abs(offset) >= 10.0, 10.0, 1.0)
    direction = jnp.where(offset == 0.0, jnp.sign(problem.light), jnp.sign(offset))
    is_known = jnp.sqrt(belief.covariance[0, 0]) <= threshold
    return jnp.where(is_known, qmdp(problem, key, belief), -direction * length)


def aside_first(problem: LightDark, key: Key[Array, ""], belief: Particles) -> Float[Array, "1"]:
    """Move by +10 until one state has a probability above 0.9; then QMDP."""
    index = belief.states[:, 0].astype(jnp.int32) + problem.radius
    zeros = jnp.zeros(2 * problem.radius + 1, belief.log_weights.dtype)
    is_known = jnp.max(zeros.at[index].add(jnp.exp(belief.log_weights))) > 0.9
    return jnp.where(is_known, qmdp(problem, key, belief), 10.0)


def ping_first(problem: SubHunt, key: Key[Array, ""], belief: Particles) -> Float[Array, "1"]:
    """Ping once, which makes the target aware; then QMDP."""
    is_aware = belief.states[0, 5] == 1.0
    return jnp.where(is_aware, qmdp(problem, key, belief), jnp.asarray(PING, belief.states.dtype))


def slow_down(problem: PomdpLander, key: Key[Array, ""], belief: Particles) -> Float[Array, "3"]:
    """Push against the mean velocity by `braking_gain` times it, as far as engines allow."""
    mean = belief.mean
    forces = -problem.braking_gain * mean[3:5]
    action = jnp.stack([forces[0], forces[1], jnp.zeros_like(mean[0])])
    return jnp.clip(action, problem.action_low, problem.action_high)


_POLICIES = (
    to_next_ml,
    to_next_mean,
    manage_uncertainty,
    qmdp,
    localise_first,
    aside_first,
    ping_first,
    slow_down,
)
POLICIES = {policy.__name__.replace("_", "-"): policy for policy in _POLICIES}
"""The policies by name."""


def policy_named(policy: Any) -> Any:
    """The policy of a name, or ValueError; a policy, or None, as it is."""
    if isinstance(policy, str) and policy not in POLICIES:
        raise ValueError(f'policy: got "{policy}"; allowed: {", ".join(POLICIES)}')
    return POLICIES[policy] if isinstance(policy, str) else policy
