"""Problems, planners and random numbers for tests of belief searches."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bojax.numerics.choices import one_of
from bojax.numerics.simulation_keys import random_index, simulation_key
from bojax.planning.belief_planner import draw_states
from bojax.planning.leaf_values import Rollout, draw_alive
from bojax.planning.pft import PFT, BeliefStep
from bojax.planning.pomcpow import POMCPOW
from bojax.planning.proposals import RandomProposal
from bojax.planning.tree import UNVISITED
from bojax.planning.widening import Widening
from bojax.problems.actions import Box, Discrete
from bojax.problems.particles import initial
from bojax.problems.state_space import StateProblem
from tests.reference import belief_search as reference

RECOMMENDATION = one_of("value", "visits")

ITERATIONS = 150
"""Of most searches, which share a program for each planner."""


def number(x):
    return jnp.asarray(x, float)


class Drift(StateProblem):
    """A position that actions push; beyond 2 the episode ends. `sensor_noise` 0 makes all weights vanish."""

    discount: jax.Array
    sensor_noise: jax.Array
    end: jax.Array
    space: Box | Discrete
    max_steps: int = eqx.field(static=True, default=20)

    @property
    def actions(self):
        return self.space

    def initial(self, key):
        return jax.random.normal(key, (1,), float)

    def step(self, key, state, action):
        moved = state + action + 0.3 * jax.random.normal(key, (1,), float)
        ended = jnp.abs(moved[0]) > self.end
        return moved, jnp.where(ended, -5.0, -(moved[0] ** 2)), ended

    def observe(self, key, state, action, next_state):
        return next_state + self.sensor_noise * jax.random.normal(key, (1,), float)

    def log_likelihood(self, observation, state, action, next_state):
        return -0.5 * jnp.sum((observation - next_state) ** 2) / self.sensor_noise**2

    def heuristic_value(self, state):
        return -3.0 * jnp.abs(state[0])


class BinaryDrift(Drift):
    """`Drift` with an observation of the half that the state is in, 0 or 1, right in 4 of 5 cases."""

    has_discrete_observations = True

    def observe(self, key, state, action, next_state):
        is_right = jax.random.bernoulli(key, 0.8)
        return jnp.where(is_right, next_state > 0.0, next_state <= 0.0).astype(float)

    def log_likelihood(self, observation, state, action, next_state):
        is_right = (observation[0] > 0.0) == (next_state[0] > 0.0)
        return jnp.log(jnp.where(is_right, 0.8, 0.2))


def drift(sensor_noise=0.5, end=2.0, discrete=False, kind=Drift):
    space = Discrete(jnp.asarray([[-0.7], [0.0], [0.7]])) if discrete else Box(-jnp.ones(1), jnp.ones(1))
    return kind(number(0.9), number(sensor_noise), number(end), space)


def belief_of(problem, num=50, seed=1):
    return _initial(problem, jax.random.key(seed), num)


_initial = eqx.filter_jit(initial)


@eqx.filter_jit
def search(planner, key, problem, belief):
    return planner.search(key, problem, belief)


def totals_by_action(tree):
    """The totals of each action of each belief node of one tree, or of several; zeros without a visit."""
    children, totals = np.asarray(tree.children), np.asarray(tree.totals)
    flat = children.reshape(*children.shape[:-2], -1, 1)
    rows = np.take_along_axis(totals, flat, axis=-2).reshape(*children.shape, -1)
    return np.where((children != UNVISITED)[..., None], rows, 0.0)


def reference_tree(planner, key, problem, belief):
    """The root of the tree of a NumPy reference, from the draws of a planner."""
    draws = Draws(key, problem, belief, planner)
    settings = SETTINGS | {"discount": 0.9, "num_actions": getattr(problem.actions, "count", None)}
    if isinstance(planner, POMCPOW):
        kind = reference.JoinedPOMCPOW if problem.has_discrete_observations else reference.POMCPOW
        settings["observation_widening"] = tuple(jax.tree.leaves(planner.observation_widening))
        return kind(draws, **settings).search(None, planner.iterations)
    root = eqx.filter_jit(planner.root)(draws.root_key, problem, belief)
    content = np.asarray(root.states), np.asarray(root.alive)
    return reference.PFT(draws, **settings).search(content, planner.iterations)


SETTINGS = {
    "exploration": 4.0,
    "widening": (2.0, 0.35),
    "observation_widening": (1.5, 0.4),
    "depth": 5,
    "max_branches": 6,
}


def planner(name, iterations, **changes):
    """A planner of `SETTINGS` with changes."""
    settings = SETTINGS | {"max_actions": 40, "num_particles": 5, "published": False} | changes
    shared = {
        "exploration": number(settings["exploration"]),
        "action_widening": Widening(*map(number, settings["widening"])),
        "observation_widening": Widening(*map(number, settings["observation_widening"])),
        "proposal": settings.get("proposal", RandomProposal()),
        "leaf_value": settings.get("leaf_value", Rollout()),
        "recommendation": RECOMMENDATION("value"),
        "first_action": settings.get("first_action"),
        "iterations": iterations,
        "depth": settings["depth"],
        "max_actions": settings["max_actions"],
        "max_branches": settings["max_branches"],
        "trees": settings.get("trees", 1),
        "merge_lengthscale": number(0.3),
    }
    if name == "pft":
        step = BeliefStep(settings["published"])
        return PFT(**shared, belief_step=step, num_particles=settings["num_particles"])
    return POMCPOW(**shared, num_reservoirs=settings.get("num_reservoirs", 4))


class Draws:
    """The random numbers of `planner.search(key, problem, belief)`, one call at a time."""

    def __init__(self, key, problem, belief, planner):
        self.root_key, key_states, _, self.search_key = jax.random.split(simulation_key(key), 4)
        self.states = np.asarray(draw_states(key_states, belief, planner.iterations))
        self._given = jax.random.key_data(self.search_key), problem, planner.leaf_value
        names = "action branch leaf_value particle resampling observation move new_step next_step places"
        names += " drawn branch_by_count"
        for name in names.split():
            setattr(self, name, partial(self._drawn, globals()[f"_{name}"]))
        self.decode = partial(_on_numpy, _decode, problem)

    def _drawn(self, function, *arguments):
        return _on_numpy(function, *self._given, self.i, *arguments)

    def begin(self, i):
        self.i = i

    def state(self):
        return self.states[self.i]


def _on_numpy(function, *arguments):
    """What a function of arrays returns, as NumPy arrays and Python numbers; compiled once for all tests."""
    integers_are_short = [np.asarray(x, np.int32) if isinstance(x, int) else x for x in arguments]
    results = jax.tree.map(np.asarray, eqx.filter_jit(function)(*integers_are_short))
    return jax.tree.map(lambda x: x.item() if x.ndim == 0 else x, results)


def _decode(problem, parameters):
    return problem.actions.decode(parameters)


IMPLEMENTATION = jax.random.key_impl(simulation_key(jax.random.key(0)))

# What iteration `i` of a search with this key draws.


def _part(key, i, which):
    key = jax.random.wrap_key_data(key, impl=IMPLEMENTATION)  # data, since a key may be used once
    return jax.random.split(jax.random.fold_in(key, i), 4)[which]


def _level_keys(key, i, level):
    return jax.random.split(jax.random.fold_in(_part(key, i, 0), level), 3)


def _particle_keys(key, i):
    key_state, key_step = jax.random.split(_part(key, i, 2))
    return key_state, *jax.random.split(key_step, 5)


def _action(key, problem, leaf_value, i):
    return problem.actions.sample(_part(key, i, 1))


def _branch(key, problem, leaf_value, i, level, number):
    return random_index(_level_keys(key, i, level)[0], number)


def _leaf_value(key, problem, leaf_value, i, states, alive, left):
    return leaf_value(_part(key, i, 3), problem, states, alive, left)


def _particle(key, problem, leaf_value, i, alive):
    return draw_alive(_particle_keys(key, i)[0], alive)


def _resampling(key, problem, leaf_value, i):
    return jax.random.uniform(_particle_keys(key, i)[4], (), float)


def _observation(key, problem, leaf_value, i, state, action):
    _, key_state, key_observation, *_ = _particle_keys(key, i)
    next_state, _, ended = problem.step(key_state, state, action)
    return problem.observe(key_observation, state, action, next_state), ended


def _move(key, problem, leaf_value, i, states, action, observation):
    keys = jax.random.split(_particle_keys(key, i)[3], len(states))
    moved, rewards, terminated = jax.vmap(problem.step, (0, 0, None))(keys, states, action)
    likelihood = jax.vmap(problem.log_likelihood, (None, 0, None, 0))
    likelihoods = jnp.exp(likelihood(observation, states, action, moved))
    return moved, rewards, terminated, jnp.nan_to_num(likelihoods)


def _new_step(key, problem, leaf_value, i, state, action):
    return _stepped(_part(key, i, 2), problem, state, action)


def _stepped(key, problem, state, action):
    key_step, key_observation = jax.random.split(key)
    next_state, reward, ended = problem.step(key_step, state, action)
    observation = problem.observe(key_observation, state, action, next_state)
    likelihood = jnp.exp(problem.log_likelihood(observation, state, action, next_state))
    return next_state, reward, ended, observation, likelihood


def _next_step(key, problem, leaf_value, i, level, state, action, observation):
    key_step, *_ = jax.random.split(_level_keys(key, i, level)[1], 3)
    next_state, reward, ended = problem.step(key_step, state, action)
    likelihood = jnp.exp(problem.log_likelihood(observation, state, action, next_state))
    return next_state, reward, ended, likelihood


def _drawn(key, problem, leaf_value, i, level, state, action):
    return _stepped(_level_keys(key, i, level)[2], problem, state, action)


def _branch_by_count(key, problem, leaf_value, i, level, counts):
    uniform = jax.random.uniform(_level_keys(key, i, level)[0], (), float)
    return jnp.searchsorted(jnp.cumsum(counts), uniform * jnp.sum(counts), side="right")


def _places(key, problem, leaf_value, i, level, number):
    _, key_places, key_draw = jax.random.split(_level_keys(key, i, level)[1], 3)
    return jax.random.uniform(key_places, (4,), float), random_index(key_draw, number)
