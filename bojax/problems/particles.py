"""Beliefs of weighted particles: the bootstrap filter (Gordon et al., 1993) with systematic resampling.

Termination is observed: while an episode goes on, no terminal particle can be the state.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.numerics.linalg import matmul
from bojax.problems.state_model import Action, Observation, State, StateModel


class Particles(eqx.Module):
    """A belief of `M` weighted states."""

    states: Float[Array, "M D"]
    log_weights: Float[Array, "M"]  # logarithms of the weights, which sum to 1
    terminal: Bool[Array, "M"]  # whether a state is terminal
    # How often no particle explained an observation; None if it is not counted
    collapses: Int[Array, ""] | None = None
    # How often an action was outside of the space; None if it is not counted
    outside: Int[Array, ""] | None = None

    def counted(self) -> "Particles":
        """The belief at the start of an episode, whose counts are 0."""
        zero = jnp.zeros((), jnp.int32)
        return replace(self, collapses=zero, outside=zero)

    @property
    def mean(self) -> State:
        """Weighted mean."""
        return matmul(jnp.exp(self.log_weights), self.states)

    @property
    def covariance(self) -> Float[Array, "D D"]:
        """Weighted covariance; with equal weights, the sum is divided by M, not by M - 1."""
        offsets = self.states - self.mean[None]
        return matmul((offsets * jnp.exp(self.log_weights)[:, None]).T, offsets)

    def quantiles(self, num: int) -> Float[Array, "N D"]:
        """`num` states that represent the belief: those at equal distances in the sum of the weights."""
        ends = jnp.cumsum(jnp.exp(self.log_weights))
        at = (jnp.arange(num, dtype=ends.dtype) + 0.5) / num * ends[-1]
        return self.states[jnp.searchsorted(ends, at)]

    def sample(self, key: Key[Array, ""]) -> State:
        """A state drawn by weight."""
        return self.states[jax.random.categorical(key, self.log_weights)]


def initial(problem: StateModel, key: Key[Array, ""], num_particles: int) -> Particles:
    """The initial belief: particles of equal weight."""
    states = jax.vmap(problem.initial)(jax.random.split(key, num_particles))
    return Particles(states, _equal(states), jnp.zeros(num_particles, bool))


def update(
    problem: StateModel, key: Key[Array, ""], particles: Particles, action: Action, observation: Observation
) -> tuple[Particles, Bool[Array, ""]]:
    """The belief after an action and an observation, and whether it has collapsed, see `condition`."""
    propagate_key, condition_key = jax.random.split(key)
    moved, _ = propagate(problem, propagate_key, particles, action)
    return condition(problem, condition_key, particles, action, moved, observation)


def propagate(
    problem: StateModel, key: Key[Array, ""], particles: Particles, action: Action
) -> tuple[Particles, Float[Array, "M"]]:
    """The particles after an action, each in its place and with its weight, and the reward of each."""
    keys = jax.random.split(key, particles.states.shape[0])
    states, rewards, terminated = jax.vmap(problem.step, (0, 0, None))(keys, particles.states, action)
    return Particles(states, particles.log_weights, particles.terminal | terminated), rewards


def condition(
    problem: StateModel,
    key: Key[Array, ""],
    before: Particles,
    action: Action,
    moved: Particles,
    observation: Observation,
) -> tuple[Particles, Bool[Array, ""]]:
    """Weigh moved particles by an observation of a state that is not terminal, and resample.

    A likelihood of NaN counts as zero, as in the searches. The belief has collapsed if no weight is left, or
    one is infinite. Then the moved particles that are not terminal, or if there are none all of them, stay
    with equal weights.
    """
    likelihood = jax.vmap(problem.log_likelihood, (None, 0, None, 0))
    log_likelihoods = likelihood(observation, before.states, action, moved.states)
    is_weighed = ~moved.terminal & ~jnp.isnan(log_likelihoods)
    log_weights = jnp.where(is_weighed, moved.log_weights + log_likelihoods, -jnp.inf)
    collapsed = ~jnp.isfinite(jnp.max(log_weights))
    left = jnp.where(moved.terminal & ~jnp.all(moved.terminal), -jnp.inf, 0.0).astype(log_weights.dtype)
    indices = systematic(key, jnp.where(collapsed, left, log_weights))
    return Particles(moved.states[indices], _equal(moved.states), moved.terminal[indices]), collapsed


def systematic(
    key: Key[Array, ""], log_weights: Float[Array, "M"], num: int | None = None
) -> Int[Array, "N"]:
    """Indices drawn by systematic resampling: one uniform number places `num` equidistant points.

    There are as many indices as weights if `num` is None. The weights need not sum to 1; one at least is
    above 0.
    """
    num = log_weights.shape[0] if num is None else num
    weights = jnp.exp(log_weights - jnp.max(log_weights))
    # A prefix sum that is computed in parallel may fall or rise by rounding where a weight is 0: such a
    # particle takes the sum before it, so that it owns no point.
    ends = jax.lax.cummax(jnp.where(weights > 0.0, jnp.cumsum(weights), 0.0))
    offset = jax.random.uniform(key, (), weights.dtype)
    # Particle i owns the points j with ends[i - 1] <= (j + offset) / num < ends[i], in units of the sum.
    bounds = jnp.ceil(num * (ends / ends[-1]) - offset).astype(jnp.int32)
    bounds = jnp.where(ends >= ends[-1], num, bounds)
    return jnp.cumsum(jnp.zeros(num, jnp.int32).at[bounds].add(1, mode="drop"), dtype=jnp.int32)


def _equal(states: Float[Array, "M D"]) -> Float[Array, "M"]:
    """Logarithms of equal weights."""
    return jnp.full(states.shape[0], -jnp.log(states.shape[0]), states.dtype)
