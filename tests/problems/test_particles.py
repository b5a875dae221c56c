"""Beliefs of particles against Kalman's and Bayes's, resampling against plain Python, and collapses."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from typing_extensions import override

from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.problems import kalman, particles
from bojax.problems.actions import Box
from bojax.problems.particles import Particles, systematic
from bojax.problems.state_space import StateProblem
from tests.reference import state_problems as reference


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("num", [None, 7, 100])
def test_systematic_resampling(num, dtype):
    rng = np.random.default_rng(0)
    resample = jax.jit(lambda key, log_weights: systematic(key, log_weights, num))
    for trial in range(40):
        weights = rng.exponential(size=20) * (rng.uniform(size=20) < (0.3 if trial % 2 else 0.9))
        weights[rng.integers(20)] = 1.0
        with np.errstate(divide="ignore"):
            log_weights = jnp.asarray(np.log(weights) - 700.0 * (trial % 3), dtype)
        indices = np.asarray(resample(jax.random.key(trial), log_weights))
        offset = float(jax.random.uniform(jax.random.key(trial), (), dtype))
        assert list(indices) == reference.systematic(weights, offset, num or 20)


def test_a_particle_without_weight_is_never_drawn():
    rng = np.random.default_rng(1)
    draw = jax.jit(jax.vmap(systematic))
    for count in (10_000, 9_999):
        alive = rng.uniform(size=count) < 0.4
        log_weights = jnp.asarray(np.where(alive, rng.normal(size=count), -np.inf), jnp.float32)
        indices = np.asarray(draw(jax.random.split(jax.random.key(2), 50), jnp.stack([log_weights] * 50)))
        assert np.all(alive[indices])
        # As often as expected, to within one.
        weights = np.where(alive, np.exp(np.asarray(log_weights, float)), 0.0)
        expected = count * weights / weights.sum()
        counts = np.array([np.bincount(row, minlength=count) for row in indices])
        assert np.all(np.abs(counts - expected) < 1.02)


def test_moments_are_weighted():
    rng = np.random.default_rng(3)
    states, weights = rng.normal(size=(50, 3)), rng.dirichlet(np.ones(50))
    belief = Particles(jnp.asarray(states), jnp.log(jnp.asarray(weights)), jnp.zeros(50, bool))
    covariance = np.cov(states.T, aweights=weights, ddof=0)
    found = jax.jit(lambda of: (of.mean, of.covariance, of.quantiles(8)))(belief)
    np.testing.assert_allclose(found[0], weights @ states)
    np.testing.assert_allclose(found[1], covariance)
    ends = np.cumsum(weights)
    at = [next(i for i in range(50) if (j + 0.5) / 8 <= ends[i]) for j in range(8)]
    np.testing.assert_array_equal(found[2], states[at])
    drawn = jax.jit(jax.vmap(belief.sample))(jax.random.split(jax.random.key(4), 20_000))
    error = np.sqrt(np.diag(covariance) / 20_000)
    assert np.all(np.abs(np.mean(drawn, axis=0) - weights @ states) < 4.0 * error)


LQG = build(kinds("problem")["lqg"](max_steps=10))


def test_kalman_conditions_the_joint_gaussian():
    rng = np.random.default_rng(5)
    a, b, c = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(2, 3))
    q, r, p = (m @ m.T for m in (rng.normal(size=(3, 4)), rng.normal(size=(2, 3)), rng.normal(size=(3, 5))))
    mean, action, observation = rng.normal(size=3), rng.normal(size=2), rng.normal(size=2)
    predicted, spread = a @ mean + b @ action, a @ p @ a.T + q
    # The joint covariance of the next state and the observation.
    joint = np.block([[spread, spread @ c.T], [c @ spread, c @ spread @ c.T + r]])
    gain = joint[:3, 3:] @ np.linalg.inv(joint[3:, 3:])
    model = kalman.LinearGaussian(*map(jnp.asarray, (a, b, c, q, r)))
    start = kalman.Gaussian(jnp.asarray(mean), jnp.asarray(p))
    found = jax.jit(kalman.update)(model, start, action, observation)
    np.testing.assert_allclose(found.mean, predicted + gain @ (observation - c @ predicted))
    np.testing.assert_allclose(found.covariance, joint[:3, :3] - gain @ joint[3:, :3], atol=1e-12)


def test_the_gaussian_belief_of_the_lander_is_the_extended_kalman_filter():
    lander = build(kinds("problem")["pomdp-lander"](belief_update="gaussian"))
    define = reference.PomdpLander()
    belief = particles.initial(lander, jax.random.key(7), 100_000)
    action, observation = np.array([4.0, 9.0, -0.5]), np.array([46.0, 0.1, 1.2])
    found, collapsed = eqx.filter_jit(lander.filter)(jax.random.key(8), belief, action, observation)
    assert not collapsed

    def jacobian(function, at):
        steps = 1e-6 * np.eye(len(at))
        return np.stack([(function(at + step) - function(at - step)) / 2e-6 for step in steps], axis=1)

    def sensed(state):
        return define.observation(action, state)[0]

    start = np.asarray(belief.mean)
    transition = jacobian(lambda state: define.step(state, action)[0], start)
    mean, noise = define.step(start, action)
    spread = transition @ np.asarray(belief.covariance) @ transition.T + np.diag(noise**2)
    sensor, sensor_noise = jacobian(sensed, mean), define.observation(action, mean)[1]
    gain = spread @ sensor.T @ np.linalg.inv(sensor @ spread @ sensor.T + np.diag(sensor_noise**2))
    mean, covariance = mean + gain @ (observation - sensed(mean)), spread - gain @ sensor @ spread

    # Drawn states, in units of the exact deviations, are independent standard normal numbers.
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), (np.asarray(found.states) - mean).T)
    np.testing.assert_allclose(whitened.mean(axis=1), 0.0, atol=5.0 / 100_000**0.5)
    np.testing.assert_allclose(whitened @ whitened.T / 100_000, np.eye(6), atol=5.0 * (2.0 / 100_000) ** 0.5)


def test_a_gaussian_belief_on_the_ground_has_collapsed():
    lander = build(kinds("problem")["pomdp-lander"](belief_update="gaussian"))
    update = eqx.filter_jit(lander.filter)
    for height, expected in ((40.0, False), (-20.0, True)):
        belief = particles.initial(lander, jax.random.key(9), 100)
        belief = dataclasses.replace(belief, states=belief.states.at[:, 1].set(height + 4.0))
        found, collapsed = update(jax.random.key(10), belief, jnp.zeros(3), jnp.array([height, 0.0, 0.0]))
        assert bool(collapsed) is bool(jnp.all(found.terminal)) is expected


def test_the_error_of_particles_falls_with_the_root_of_their_number():
    @eqx.filter_jit
    def errors(key, count):
        def run(key):
            start_key, belief_key, key = jax.random.split(key, 3)
            action = jnp.asarray([1.0, -2.0])

            def advance(carry, step):
                state, gaussian, belief = carry
                keys = jax.random.split(jax.random.fold_in(key, step), 3)
                following = LQG.step(keys[0], state, action)[0]
                observation = LQG.observe(keys[1], state, action, following)
                gaussian = kalman.update(LQG.model, gaussian, action, observation)
                belief, _ = particles.update(LQG, keys[2], belief, action, observation)
                return (following, gaussian, belief), None

            start = (LQG.initial(start_key), LQG.gaussian_prior, particles.initial(LQG, belief_key, count))
            _, gaussian, belief = jax.lax.scan(advance, start, jnp.arange(2, dtype=jnp.uint32))[0]
            return belief.mean[:2] - gaussian.mean, belief.covariance[:2, :2] - gaussian.covariance

        return jax.vmap(run)(jax.random.split(key, 1000))

    counts = np.array([50, 800])
    found = [errors(jax.random.key(6), int(count)) for count in counts]
    for part in (0, 1):
        # The median: a few improbable observations, which few particles explain, dominate a mean square.
        sizes = [np.median(np.abs(error[part])) for error in found]
        slope = np.diff(np.log(sizes))[0] / np.diff(np.log(counts))[0]
        assert slope == pytest.approx(-0.5, abs=0.05)


def test_particles_follow_bayes():
    tiger = build(kinds("problem")["tiger"]())
    listen, left = jnp.zeros(1), jnp.zeros(1)
    belief = particles.initial(tiger, jax.random.key(7), 40_000)
    update = eqx.filter_jit(particles.update)
    for step in range(2):
        belief, collapsed = update(tiger, jax.random.key(8 + step), belief, listen, left)
        assert not collapsed
        odds = (0.15 / 0.85) ** (step + 1)
        assert belief.mean[0] == pytest.approx(odds / (1.0 + odds), abs=0.01)


class Fading(StateProblem):
    """A step ends the episode above 1, and adds the action; an observation of 1 to 4 is odd."""

    discount: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(0.5))
    max_steps: int = eqx.field(static=True, default=5)

    @property
    @override
    def actions(self):
        return Box(-jnp.ones(1), jnp.ones(1))

    @override
    def initial(self, key):
        return jax.random.uniform(key, (1,))

    @override
    def step(self, key, state, action):
        following = state + action
        return following, jnp.ones(()), following[0] > 1.0

    @override
    def observe(self, key, state, action, next_state):
        return jnp.zeros(1)

    @override
    def log_likelihood(self, observation, state, action, next_state):
        impossible = jnp.where(observation[0] == 1.0, -jnp.inf, 0.0)
        is_nan = (observation[0] == 2.0) | ((observation[0] == 4.0) & (next_state[0] < 0.75))
        return jnp.where(is_nan, jnp.nan, jnp.where(observation[0] == 3.0, jnp.inf, impossible))


FADING = Fading()
update = jax.jit(lambda *given: particles.update(FADING, *given))


@pytest.mark.parametrize(("reading", "least"), [(0.0, 0.5), (4.0, 0.75)])
def test_particles_that_are_terminal_or_have_a_likelihood_of_nan_have_no_weight(reading, least):
    start = particles.initial(FADING, jax.random.key(9), 200)
    belief, collapsed = update(jax.random.key(10), start, jnp.full(1, 0.5), jnp.full(1, reading))
    states = np.ravel(start.states) + 0.5
    assert not collapsed and not np.any(belief.terminal) and np.any(states < 0.75) and np.any(states > 1.0)
    assert set(np.ravel(belief.states)) == set(states[(states >= least) & (states <= 1.0)])


@pytest.mark.parametrize("reading", [1.0, 2.0, 3.0])
def test_a_belief_without_weights_collapses(reading):
    start = particles.initial(FADING, jax.random.key(11), 200)
    belief, collapsed = update(jax.random.key(12), start, jnp.full(1, 0.5), jnp.full(1, reading))
    assert collapsed
    # The particles that are not terminal, each as often as the others to within one.
    counts = np.unique(np.asarray(belief.states), return_counts=True)
    assert set(counts[0]) == set(np.ravel(start.states)[np.ravel(start.states) <= 0.5] + 0.5)
    assert np.ptp(counts[1]) <= 1
    assert_finite(belief)


@pytest.mark.parametrize("reading", [0.0, 1.0, 2.0])
def test_a_belief_of_terminal_particles_collapses(reading):
    start = particles.initial(FADING, jax.random.key(13), 200)
    belief, collapsed = update(jax.random.key(14), start, jnp.full(1, 2.0), jnp.full(1, reading))
    assert collapsed
    assert np.all(belief.terminal)
    np.testing.assert_array_equal(belief.states, start.states + 2.0)
    assert_finite(belief)
    belief, collapsed = update(jax.random.key(15), belief, jnp.full(1, -0.5), jnp.zeros(1))
    assert collapsed  # a terminal particle stays terminal
    assert_finite(belief)


def assert_finite(belief):
    assert np.all(np.isfinite(belief.states))
    assert np.all(np.isfinite(belief.mean))
    assert np.all(np.isfinite(belief.covariance))
    np.testing.assert_allclose(belief.log_weights, -np.log(len(belief.log_weights)))


def test_one_belief_equals_its_lane_of_a_batch():
    problem = build(kinds("problem")["vdp-tag"]())
    action, observation = jnp.asarray([1.0, 1.0]), jnp.full(8, 1.5)

    def run(key):
        start_key, update_key = jax.random.split(key)
        return particles.update(
            problem, update_key, particles.initial(problem, start_key, 100), action, observation
        )

    batch, _ = jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(16), 6))
    for lane in (0, 5):
        single, _ = jax.jit(run)(jax.random.split(jax.random.key(16), 6)[lane])
        np.testing.assert_allclose(single.states, batch.states[lane], rtol=1e-12)
