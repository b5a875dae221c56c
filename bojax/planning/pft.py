"""PFT-DPW: a tree of particle beliefs (Sunberg and Kochenderfer, ICAPS 2018, Algorithm 3)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.numerics.lanes import any_lane
from bojax.numerics.linalg import matmul
from bojax.planning.belief_planner import BeliefSearch
from bojax.planning.belief_search import Expansion
from bojax.planning.leaf_values import (
    LeafValue,
    ParticleSet,
    Policy,
    draw_alive,
    prefix_sums,
    simulated_return,
)
from bojax.planning.oracles import policy_named
from bojax.planning.tree import ROOT, Index, Tree, row
from bojax.problems.particles import Particles, systematic
from bojax.problems.state_model import Action, State
from bojax.problems.state_space import StateProblem

ENTROPY_FLOOR = 1e-6
"""Variance added to each component of a state where an entropy is taken."""


class BeliefStep(eqx.Module):
    """The belief MDP: an action and a simulated observation lead from one particle set to the next.

    The reward is the mean of the particles' rewards, weighted by the likelihood of the observation.

    By default termination is observed: the belief ends if the state that the observation is drawn from ends;
    otherwise particles that end have no weight. If no weight is left, the moved particles stay, unweighted.

    The published program instead weighs particles that end as the others, and the belief ends once all have.
    What follows a belief is then not multiplied by the probability of survival. If the weights sum to less
    than the spacing of float64 numbers at 1/M, the belief is drawn anew from the initial one, with reward 0.
    """

    is_published: bool = eqx.field(static=True)  # whether termination is treated as in the published program

    def __call__(
        self, key: Key[Array, ""], problem: StateProblem, belief: ParticleSet, state: State, action: Action
    ) -> tuple[ParticleSet, Float[Array, ""], Bool[Array, ""], Float[Array, ""]]:
        """The next belief, its reward, whether it is terminal, and its entropy before it was resampled.

        The observation is drawn from `state`.
        """
        key_state, key_observation, key_move, key_resample, key_prior = jax.random.split(key, 5)
        next_state, _, ended = problem.step(key_state, state, action)
        observation = problem.observe(key_observation, state, action, next_state)

        num = belief.alive.shape[0]
        keys = jax.random.split(key_move, num)
        moved, rewards, terminated = jax.vmap(problem.step, (0, 0, None))(keys, belief.states, action)
        likelihood = jax.vmap(problem.log_likelihood, (None, 0, None, 0))
        log_weights = likelihood(observation, belief.states, action, moved)
        log_weights = jnp.where(belief.alive & ~jnp.isnan(log_weights), log_weights, -jnp.inf)

        if self.is_published:
            largest = jnp.max(log_weights)
            # Spacing of float64 numbers, whatever the precision here: densities are small numbers.
            num_alive = jnp.sum(belief.alive, dtype=rewards.dtype)
            least = jnp.log(2.0) * (jnp.floor(-jnp.log2(num_alive)) - 52.0)
            log_sum = jnp.where(largest > -jnp.inf, jax.nn.logsumexp(log_weights), -jnp.inf)
            collapsed = (log_sum < least) & (num_alive > 0.0)
            log_weights = jnp.where(collapsed, 0.0, log_weights)
            indices = resample(key_resample, log_weights)
            # Rare, and on Light Dark as expensive as all else.
            prior = jax.lax.cond(
                any_lane(collapsed),
                lambda: jax.vmap(problem.initial)(jax.random.split(key_prior, num)),
                lambda: moved,
            )
            states = jnp.where(collapsed, prior, moved[indices])
            alive = collapsed | (belief.alive & ~terminated)[indices]
            reward = jnp.where(collapsed, 0.0, weighted_mean(log_weights, rewards))
            return ParticleSet(states, alive), reward, ~jnp.any(alive), entropy(log_weights, moved)

        left = belief.alive & ~terminated
        reward = weighted_mean(_or_equal(log_weights, belief.alive), rewards)
        weighted = _or_equal(jnp.where(left, log_weights, -jnp.inf), left)
        indices = resample(key_resample, weighted)
        after = ParticleSet(moved[indices], left[indices])
        return after, reward, ended | ~jnp.any(left), entropy(weighted, moved)


def belief_step_named(name: str | BeliefStep) -> BeliefStep:
    """The belief MDP in which termination is `observed`, or treated as `published`; ValueError otherwise."""
    if isinstance(name, str) and name not in ("observed", "published"):
        raise ValueError(f'belief_step: got "{name}"; allowed: observed, published')
    return BeliefStep(name == "published") if isinstance(name, str) else name


def resample(key: Key[Array, ""], log_weights: Float[Array, "M"]) -> Int[Array, "M"]:
    """Systematic resampling of a few particles, by comparing all pairs."""
    num = log_weights.shape[0]
    ends = prefix_sums(_weights(log_weights))
    points = (jnp.arange(num, dtype=ends.dtype) + jax.random.uniform(key, (), ends.dtype)) / num
    # A point that is rounded to the sum of the weights would lie behind the last particle.
    points = jnp.minimum(points, 1.0 - jnp.finfo(ends.dtype).eps) * ends[-1]
    return jnp.minimum(jnp.sum(ends[None] <= points[:, None], axis=1, dtype=jnp.int32), num - 1)


def weighted_mean(log_weights: Float[Array, "M"], values: Float[Array, "M"]) -> Float[Array, ""]:
    """The mean of values; those without a weight may be anything."""
    weights = _weights(log_weights)
    total = jnp.sum(jnp.where(weights > 0.0, weights * values, 0.0))
    return total / jnp.maximum(jnp.sum(weights), 1.0)


def entropy(log_weights: Float[Array, "M"], states: Float[Array, "M D"]) -> Float[Array, ""]:
    """Entropy of a Gaussian with the covariance of weighted states, in nats, up to a constant.

    `ENTROPY_FLOOR` is added to each variance: components that are known have no density.
    """
    weights = _weights(log_weights)
    share = weights / jnp.maximum(jnp.sum(weights), 1.0)
    offsets = states - matmul(share, states)[None]
    floor = ENTROPY_FLOOR * jnp.eye(states.shape[1], dtype=states.dtype)
    return 0.5 * jnp.linalg.slogdet(matmul((offsets * share[:, None]).T, offsets) + floor)[1]


def _weights(log_weights: Float[Array, "M"]) -> Float[Array, "M"]:
    """Weights scaled to a maximum of 1; zeros if all logarithms are -inf."""
    largest = jnp.max(log_weights)
    return jnp.where(jnp.isfinite(largest), jnp.exp(log_weights - largest), 0.0)


def _or_equal(log_weights: Float[Array, "M"], alive: Bool[Array, "M"]) -> Float[Array, "M"]:
    """The weights, or equal ones of the particles that are alive if no weight is left."""
    equal = jnp.where(alive, 0.0, -jnp.inf).astype(log_weights.dtype)
    return jnp.where(jnp.isfinite(jnp.max(log_weights)), log_weights, equal)


class PFT(BeliefSearch):
    """PFT-DPW: belief nodes are particle sets, resampled after every action.

    An action without a visit scores its initial value, 0, while its node has at most one visit, and infinity
    afterwards, as in the published program (MCTS.jl).

    With `information`, a step that does not end the episode is rewarded for the entropy that it takes from
    the belief, times this factor (a rho-POMDP: Araya-Lopez et al., NeurIPS 2010). Leaf values are without.
    """

    belief_step: BeliefStep = eqx.field(converter=belief_step_named)  # the belief MDP
    num_particles: int = eqx.field(static=True)  # particles of a belief node
    information: Float[Array, ""] | None = None  # reward of a nat of entropy; None for none

    @override
    def root(self, key: Key[Array, ""], problem: StateProblem, belief: Particles) -> ParticleSet:
        log_weights = jnp.where(belief.terminal, -jnp.inf, belief.log_weights)
        log_weights = _or_equal(log_weights, jnp.ones_like(belief.terminal))
        indices = systematic(key, log_weights, self.num_particles)
        return ParticleSet(belief.states[indices], ~belief.terminal[indices])

    @override
    def score_unvisited(self, visits: Float[Array, ""]) -> Float[Array, ""]:
        return jnp.where(visits <= 1.0, 0.0, jnp.inf)

    @override
    def expand(
        self,
        key: Key[Array, ""],
        problem: StateProblem,
        tree: Tree,
        state: State,
        node: Index,
        action: Action,
    ) -> Expansion:
        key_state, key_step = jax.random.split(key)
        belief = self.leaf_at(tree, state, node)
        # At the root, the state is drawn from the full belief, not from the few particles of the tree.
        drawn = belief.states[draw_alive(key_state, belief.alive)]
        state = jnp.where(node == ROOT, state, drawn)
        after, reward, is_terminal, later = self.belief_step(key_step, problem, belief, state, action)
        if self.information is not None:
            gained = entropy(belief.weighted().log_weights, belief.states) - later
            reward = reward + self.information * jnp.where(is_terminal, 0.0, gained)
        return Expansion(after, reward, is_terminal, after)

    @override
    def leaf_at(self, tree: Tree, state: State, node: Index) -> ParticleSet:
        return jax.tree.map(lambda leaf: row(leaf, node), tree.beliefs)


class BeliefRollout(LeafValue):
    """Return of one simulation of a policy in the belief MDP, to the horizon."""

    belief_step: BeliefStep = eqx.field(converter=belief_step_named)  # the belief MDP
    policy: Policy = eqx.field(static=True, converter=policy_named)

    @override
    def __call__(
        self,
        key: Key[Array, ""],
        problem: StateProblem,
        states: Float[Array, "M D"],
        alive: Bool[Array, "M"],
        remaining: Int[Array, ""],
    ) -> Float[Array, ""]:
        def act(key, belief):
            key_action, key_state, key_step = jax.random.split(key, 3)
            action = self.policy(problem, key_action, belief.weighted())
            state = belief.states[draw_alive(key_state, belief.alive)]
            belief, reward, ended, _ = self.belief_step(key_step, problem, belief, state, action)
            return belief, reward, ended

        total = jnp.zeros((), states.dtype)
        return simulated_return(key, act, ParticleSet(states, alive), total, problem.discount, remaining)
