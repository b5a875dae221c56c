"""POMCPOW: a tree whose beliefs are weighted as simulations pass (Sunberg and Kochenderfer, ICAPS 2018)."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.numerics.simulation_keys import random_index
from bojax.planning.belief_planner import BeliefSearch
from bojax.planning.belief_search import Draw, Expansion
from bojax.planning.leaf_values import ParticleSet
from bojax.planning.tree import UNVISITED, Index, Tree, row
from bojax.problems.particles import Particles
from bojax.problems.state_model import Action, Observation, State
from bojax.problems.state_space import StateProblem


class Reservoirs(eqx.Module):
    """Draws by weight from all simulated steps that have passed a branch."""

    steps: Float[Array, "K S"]  # K simulated steps: the state, the reward, and whether the state is terminal
    observation: Float[Array, "O"]  # the observation of the branch
    log_weight: Float[Array, ""]  # logarithm of the sum of the weights of all steps
    # Number of times that the observation was drawn, M of Algorithm 2; None if none repeats
    count: Float[Array, ""] | None


class POMCPOW(BeliefSearch):
    """POMCPOW (Algorithm 2), with reservoirs for its lists of weighted states.

    A simulation descends with a state. Where it passes an existing branch, its step is added to the branch,
    weighted by the likelihood of the branch's observation, and replaced by a draw from the branch by weight.
    With discrete observations, a repeated observation adds to the count of its branch, and a branch is then
    drawn in proportion to the counts, as in the published program (POMCPOW.jl, `check_repeat_obs`).

    Deviations from this program: the step that is added to this branch is another one than the step that drew
    the observation, whose state is already more likely given its own observation. An action without a visit
    always scores infinity, where the program gives it the value 0 while its node has at most one visit. And a
    branch keeps K reservoirs of one step in place of all steps (Chao, Biometrika 1982, for one item). A new
    step of weight w takes each place with probability w over the sum of all weights; a draw takes a random
    place. Each draw has the distribution of a draw from the list; draws of later visits are correlated, which
    makes the search optimistic. Measured on the tiger problem, two actions deep, after 12,000 iterations in
    16 lanes: 15.53 is exact; 17.2 (.6) with 4 places, 15.9 (.2) with 16, 15.56 (.03) with 64.
    """

    num_reservoirs: int = eqx.field(static=True)  # the number K

    @override
    def root(self, key: Key[Array, ""], problem: StateProblem, belief: Particles) -> Reservoirs:
        # Never read: a simulation starts with a state of the belief itself.
        state, action = belief.states[0], problem.actions.decode(problem.actions.sample(key))
        observation = jax.eval_shape(problem.observe, key, state, action, state)
        return Reservoirs(
            jnp.zeros((self.num_reservoirs, state.shape[0] + 2), state.dtype),
            jnp.zeros(observation.shape, observation.dtype),
            jnp.zeros((), state.dtype),
            jnp.zeros((), state.dtype) if problem.has_discrete_observations else None,
        )

    @override
    def draw_of(self, problem: StateProblem) -> Draw | None:
        return partial(_draw, problem) if problem.has_discrete_observations else None

    @override
    def follow(
        self,
        key: Key[Array, ""],
        problem: StateProblem,
        tree: Tree,
        state: State,
        action: Action,
        branch: Index,
        is_followed: Bool[Array, ""],
    ) -> tuple[Reservoirs, State, Float[Array, ""], Bool[Array, ""]]:
        key_step, key_places, key_draw = jax.random.split(key, 3)
        # What comes after the write of a row is read from the new array: XLA copies an array whose old rows
        # are read by what need not precede the write.
        beliefs, index = tree.beliefs, jnp.where(is_followed, branch, tree.beliefs.log_weight.shape[0])
        next_state, reward, ended = problem.step(key_step, state, action)
        log_weight = _log_weight(problem, row(beliefs.observation, branch), state, action, next_state)
        total = jnp.logaddexp(row(beliefs.log_weight, branch), log_weight)
        totals = beliefs.log_weight.at[index].set(total, mode="drop")
        # Of a branch that is not followed, all that follows is ignored.
        chance = jnp.exp(log_weight - row(totals, branch))
        probability = jnp.where(log_weight > -jnp.inf, chance, 0.0)

        is_placed = jax.random.uniform(key_places, (self.num_reservoirs,), state.dtype) < probability
        step = _packed(next_state, reward, ended)
        placed = jnp.where(is_placed[:, None], step[None], row(beliefs.steps, branch))
        steps = beliefs.steps.at[index].set(placed, mode="drop")
        drawn = row(steps, branch, random_index(key_draw, jnp.asarray(self.num_reservoirs, jnp.int32)))
        beliefs = eqx.tree_at(lambda all: (all.steps, all.log_weight), beliefs, (steps, totals))
        return beliefs, drawn[:-2], drawn[-2], drawn[-1] > 0.0

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
        next_state, reward, ended, observation = _simulated(key, problem, state, action)
        step = _packed(next_state, reward, ended)
        belief = Reservoirs(
            jnp.broadcast_to(step[None], (self.num_reservoirs, *step.shape)),
            observation,
            _log_weight(problem, observation, state, action, next_state),
            jnp.ones((), state.dtype) if problem.has_discrete_observations else None,
        )
        # A terminal state ends this simulation, not the branch: others may pass with a state that goes on.
        return Expansion(belief, reward, ended, ParticleSet(next_state[None], ~ended[None]))

    @override
    def leaf_at(self, tree: Tree, state: State, node: Index) -> ParticleSet:
        return ParticleSet(state[None], jnp.ones((1,), bool))


def _draw(
    problem: StateProblem,
    key: Key[Array, ""],
    tree: Tree,
    state: State,
    action: Action,
    branches: Int[Array, "B"],
    is_counted: Bool[Array, ""],
) -> tuple[Reservoirs, Bool[Array, ""], Float[Array, "B"]]:
    *_, observation = _simulated(key, problem, state, action)
    beliefs, is_branch = tree.beliefs, branches != UNVISITED
    is_same = is_branch & jnp.all(beliefs.observation[branches] == observation[None], axis=1)
    count = beliefs.count.at[branches].add((is_same & is_counted).astype(beliefs.count.dtype))
    beliefs = eqx.tree_at(lambda all: all.count, beliefs, count)
    return beliefs, jnp.any(is_same), jnp.where(is_branch, count[branches], 0.0)


def _simulated(
    key: Key[Array, ""], problem: StateProblem, state: State, action: Action
) -> tuple[State, Float[Array, ""], Bool[Array, ""], Observation]:
    """A step and its observation: next state, reward, whether the next state is terminal, observation."""
    key_step, key_observation = jax.random.split(key)
    next_state, reward, ended = problem.step(key_step, state, action)
    return next_state, reward, ended, problem.observe(key_observation, state, action, next_state)


def _packed(state: State, reward: Float[Array, ""], ended: Bool[Array, ""]) -> Float[Array, "S"]:
    """A step in one array, which is read and written at once."""
    return jnp.concatenate([state, reward[None], ended[None].astype(state.dtype)])


def _log_weight(
    problem: StateProblem, observation: Observation, state: State, action: Action, next_state: State
) -> Float[Array, ""]:
    log_weight = problem.log_likelihood(observation, state, action, next_state)
    return jnp.where(jnp.isnan(log_weight), -jnp.inf, log_weight)
