"""Problems, planners and random numbers for tests of belief searches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bojax.numerics.choices import one_of
from bojax.numerics.simulation_keys import random_index, simulation_key
from bojax.planning.belief_search import draw_states
from bojax.planning.belief_tree import Widening
from bojax.planning.leaf_values import Rollout, draw_alive
from bojax.planning.pft import PFT, BeliefStep
from bojax.planning.pomcpow import POMCPOW
from bojax.planning.proposals import RandomProposal
from bojax.problems.actions import Box, Discrete
from bojax.problems.state_space import StateProblem

RECOMMENDATION = one_of("value", "visits")


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


def drift(sensor_noise=0.5, end=2.0, discrete=False):
    space = Discrete(jnp.asarray([[-0.7], [0.0], [0.7]])) if discrete else Box(-jnp.ones(1), jnp.ones(1))
    return Drift(number(0.9), number(sensor_noise), number(end), space)


SETTINGS = {
    "exploration": 4.0,
    "widening": (2.0, 0.35),
    "observation_widening": (1.5, 0.4),
    "depth": 5,
}


def planner(name, iterations, **changes):
    """A planner of `SETTINGS` with changes."""
    settings = SETTINGS | {"max_actions": 40, "max_branches": 40, "num_particles": 5, "published": False}
    settings |= changes
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
        self.decode = _on_numpy(lambda parameters: problem.actions.decode(parameters))

        def part(i, which):
            key = jax.random.wrap_key_data(search_key, impl=implementation)
            return jax.random.split(jax.random.fold_in(key, i), 4)[which]

        def level_keys(i, level):
            return jax.random.split(jax.random.fold_in(part(i, 0), level))

        def particle_keys(i):
            key_state, key_step = jax.random.split(part(i, 2))
            return key_state, *jax.random.split(key_step, 5)

        def observation(i, state, action):
            _, key_state, key_observation, *_ = particle_keys(i)
            next_state, _, ended = problem.step(key_state, state, action)
            return problem.observe(key_observation, state, action, next_state), ended

        def move(i, states, action, observation):
            keys = jax.random.split(particle_keys(i)[3], len(states))
            moved, rewards, terminated = jax.vmap(problem.step, (0, 0, None))(keys, states, action)
            likelihood = jax.vmap(problem.log_likelihood, (None, 0, None, 0))
            likelihoods = jnp.exp(likelihood(observation, states, action, moved))
            return moved, rewards, terminated, jnp.nan_to_num(likelihoods)

        def new_step(i, state, action):
            key_step, key_observation = jax.random.split(part(i, 2))
            next_state, reward, ended = problem.step(key_step, state, action)
            observation = problem.observe(key_observation, state, action, next_state)
            likelihood = jnp.exp(problem.log_likelihood(observation, state, action, next_state))
            return next_state, reward, ended, observation, likelihood

        def next_step(i, level, state, action, observation):
            key_step, *_ = jax.random.split(level_keys(i, level)[1], 3)
            next_state, reward, ended = problem.step(key_step, state, action)
            likelihood = jnp.exp(problem.log_likelihood(observation, state, action, next_state))
            return next_state, reward, ended, likelihood

        def places(i, level, number):
            _, key_places, key_draw = jax.random.split(level_keys(i, level)[1], 3)
            return jax.random.uniform(key_places, (4,), float), random_index(key_draw, number)

        search_key, implementation = (
            jax.random.key_data(self.search_key),
            jax.random.key_impl(self.search_key),
        )
        self.action = self._drawn(lambda i: problem.actions.sample(part(i, 1)))
        self.branch = self._drawn(lambda i, level, num: random_index(level_keys(i, level)[0], num))
        self.leaf_value = self._drawn(
            lambda i, states, alive, left: planner.leaf_value(part(i, 3), problem, states, alive, left)
        )
        self.particle = self._drawn(lambda i, alive: draw_alive(particle_keys(i)[0], alive))
        self.resampling = self._drawn(lambda i: jax.random.uniform(particle_keys(i)[4], (), float))
        self.observation, self.move = self._drawn(observation), self._drawn(move)
        self.new_step, self.next_step = self._drawn(new_step), self._drawn(next_step)
        self.places = self._drawn(places)

    def _drawn(self, function):
        """`function` of the iteration and NumPy arguments, compiled."""
        compiled = _on_numpy(function)
        return lambda *arguments: compiled(self.i, *arguments)

    def begin(self, i):
        self.i = i

    def state(self):
        return self.states[self.i]


def _on_numpy(function):
    compiled = jax.jit(function)

    def call(*arguments):
        integers_are_short = [np.int32(x) if isinstance(x, int) else x for x in arguments]
        results = jax.tree.map(np.asarray, compiled(*integers_are_short))
        return jax.tree.map(lambda x: x.item() if x.ndim == 0 else x, results)

    return call
