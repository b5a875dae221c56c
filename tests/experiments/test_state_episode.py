"""Episodes of state problems: what is counted, and the published returns of policies without search."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from typing_extensions import override

from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.experiments.state_episode import episode
from bojax.planning import oracles
from bojax.problems import particles
from bojax.problems.actions import Box
from bojax.problems.pomdp import light_dark_filter
from bojax.problems.pomdp.sub_hunt_values import solve
from bojax.problems.state_space import StateProblem


class Counter(StateProblem):
    """Pays 1, 2, 3 and so on; ends at `last`; after step 2, no particle explains what is observed."""

    last: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(4.0))
    discount: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(0.5))
    max_steps: int = eqx.field(static=True, default=6)

    @property
    @override
    def actions(self):
        return Box(-jnp.ones(1), jnp.ones(1))

    @override
    def initial(self, key):
        return jnp.zeros(1)

    @override
    def step(self, key, state, action):
        following = state + action
        return following, following[0], following[0] >= self.last

    @override
    def observe(self, key, state, action, next_state):
        return next_state

    @override
    def log_likelihood(self, observation, state, action, next_state):
        return jnp.where(observation[0] > 2.0, -jnp.inf, 0.0)


def always(key, belief):
    return jnp.ones(1)


@pytest.mark.parametrize(
    ("last", "steps", "collapsed"),
    [(4.0, 4, 1), (6.0, 6, 3), (9.0, 6, 4), (1.0, 1, 0)],  # a collapse at the end counts for nothing
)
def test_an_episode_sums_and_counts(last, steps, collapsed):
    problem = Counter(last=jnp.asarray(last))
    found = jax.jit(lambda key: episode(problem, always, key, 8))(jax.random.key(0))
    assert found[0] == sum(0.5**t * (t + 1) for t in range(steps))
    assert tuple(map(int, found[1:])) == (steps, collapsed)


def test_the_filter_of_an_episode_is_given():
    def never(problem, key, belief, action, observation):
        return belief, jnp.zeros((), bool)

    found = jax.jit(lambda key: episode(Counter(), always, key, 8, never))(jax.random.key(0))
    assert tuple(map(int, found[1:])) == (4, 0)


@eqx.filter_jit
def returns(problem, policy, update, num_particles, keys):
    run = lambda key: episode(problem, partial(policy, problem), key, num_particles, update)  # noqa: E731
    return jax.vmap(run)(keys)


def test_episodes_equal_their_lanes():
    problem = build(kinds("state-problem")["vdp-tag"](max_steps=5))
    given = (problem, oracles.manage_uncertainty, particles.update, 100)
    batch = returns(*given, jax.random.split(jax.random.key(1), 5))
    for lane in (0, 4):
        single = returns(*given, jax.random.split(jax.random.key(1), 5)[lane : lane + 1])
        np.testing.assert_allclose([v[0] for v in single], [v[lane] for v in batch], rtol=1e-9)


def test_the_published_filter_of_light_dark_replaces_particles():
    problem = build(kinds("state-problem")["light-dark"]())
    belief = particles.initial(problem, jax.random.key(3), 1000)
    belief = dataclasses.replace(belief, states=jnp.full((1000, 1), 9.0))
    update = jax.jit(lambda key, o: light_dark_filter.update(problem, key, belief, jnp.ones(1), o))
    for offset in (0.0, 1e-4, 4e-4, 1e-3):
        found, collapsed = update(jax.random.key(4), jnp.full(1, 10.0 + offset))
        assert not collapsed
        # The likelihood of 10, against the density at the mode from where the observation is.
        ratio = np.exp(-0.5 * (offset / 1e-4) ** 2) * (offset + 1e-4) / 1e-4
        expected = np.floor(0.05 * 1000 * max(0.0, 1.0 - ratio))
        replaced = np.asarray(found.states)[np.asarray(found.states) != 10.0]
        assert len(replaced) == expected
        assert np.all(replaced == 20.0)


PUBLISHED = {
    # Sunberg and Kochenderfer (2018), raw returns of 1,000 episodes (MIT licence), 5 March and 26 February.
    "to-next-ml": ("vdp-tag", oracles.to_next_ml, (-17.05, 0.38)),
    "qmdp": ("light-dark", oracles.qmdp, (-6.37, 1.03)),
    "localise to 0.1": ("light-dark", oracles.localise_first, (27.61, 0.92)),
    "localise to 0.01": ("light-dark", partial(oracles.localise_first, threshold=0.01), (24.88, 0.86)),
    "aside first": ("light-dark", oracles.aside_first, (42.42, 0.43)),
    "hunt by qmdp": ("sub-hunt", oracles.qmdp, (27.99, 1.34)),
    "ping first": ("sub-hunt", oracles.ping_first, (79.01, 1.08)),
    # The published runs share one random stream; this is the mean of independent ones by the same author and
    # of a prototype.
    "manage-uncertainty": ("vdp-tag", oracles.manage_uncertainty, (-7.3, 0.9)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLISHED)
def test_policies_without_search_earn_what_is_published(name):
    kind, policy, (mean, error) = PUBLISHED[name]
    problem = build(kinds("state-problem")[kind](), "float32")
    if kind == "sub-hunt":
        problem = dataclasses.replace(problem, action_values=eqx.filter_jit(solve)(problem))
    update = light_dark_filter.update if kind == "light-dark" else particles.update
    found = []
    for seed in range(20):
        keys = jax.random.split(jax.random.key(seed), 50)
        found.append(np.asarray(returns(problem, policy, update, 10_000, keys)))
    earned, _, collapsed = np.concatenate(found, axis=1)
    assert len(earned) == 1000
    assert not np.any(np.isnan(earned))
    assert np.mean(collapsed > 0) < 0.01
    own = earned.std(ddof=1) / len(earned) ** 0.5
    assert abs(earned.mean() - mean) < 3.0 * np.hypot(own, error)
