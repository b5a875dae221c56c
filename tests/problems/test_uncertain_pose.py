"""Poses as particles: the model is that of the pose problem, and the belief is the exact one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.config.errors import ConfigError
from bojax.engine.build import build
from bojax.problems import particles
from bojax.problems.pomdp.settings import UncertainPose
from bojax.problems.pomdp.uncertain_pose import LEAST_NOISE


def parking(**settings):
    return build(UncertainPose.model_validate(settings))


def test_a_step_is_that_of_the_pose_problem():
    model = parking(problem={"rule": "anywhere-bearing-dropped", "distance_tolerance": 0.5})

    @jax.jit
    def both(key):
        key_pose, key_action, key_step = jax.random.split(key, 3)
        pose = model.initial(key_pose) * jnp.asarray([0.4, 0.4, 1.0])
        action = model.actions.sample(key_action)
        world, _, events = model.problem.execute(key_step, pose, model.motions.path(action))
        return model.step(key_step, pose, action), world, events

    ended = 0
    for key in jax.random.split(jax.random.key(0), 60):
        (after, reward, terminated), world, events = both(key)
        np.testing.assert_allclose(after[:2], world[:2], atol=1e-12)
        np.testing.assert_allclose(jnp.sin(after[2]), jnp.sin(world[2]), atol=1e-12)
        assert (reward, terminated) == (events.reward, events.terminated)
        ended += int(terminated)
    assert 0 < ended < 60


def test_an_observation_is_the_pose_with_the_noise_of_the_problem():
    model = parking(problem={"position_noise": 0.3, "heading_noise": 0.1})
    pose, action = jnp.asarray([1.0, -2.0, 0.5]), jnp.zeros(2)
    keys = jax.random.split(jax.random.key(1), 2000)
    seen = np.asarray(jax.vmap(lambda key: model.observe(key, pose, action, pose))(keys))
    scale = np.array([0.3, 0.3, 0.1])
    for column in ((seen - np.asarray(pose)) / scale).T:
        assert stats.kstest(column, "norm").pvalue > 1e-4
    likelihood = jax.vmap(lambda reading: model.log_likelihood(reading, pose, action, pose))
    found = likelihood(jnp.asarray(seen))
    np.testing.assert_allclose(found, stats.norm.logpdf(seen, np.asarray(pose), scale).sum(axis=1))


def test_without_noise_the_belief_is_the_pose():
    model = parking(num_particles=50, problem={"position_noise": 0.0, "heading_noise": 0.0})
    pose, action = jnp.asarray([1.0, -2.0, 0.5]), jnp.asarray([0.2, -0.4])
    belief = eqx.filter_jit(model.prior)(jax.random.key(2), pose, 1)
    np.testing.assert_array_equal(belief.states, np.tile(pose, (50, 1)))
    after, observation, _ = eqx.filter_jit(model.execute)(jax.random.key(3), pose, action)
    belief = eqx.filter_jit(model.update)(belief, action, observation, jax.random.key(4))
    np.testing.assert_array_equal(belief.states, np.tile(after, (50, 1)))
    assert belief.collapses == 0
    expected = stats.norm.logpdf(0.0, 0.0, LEAST_NOISE)
    assert model.log_likelihood(after, pose, action, after) == pytest.approx(3 * expected)


def test_the_belief_is_the_mean_of_moved_measurements():
    # With a heading that is nearly known, the position is a linear Gaussian problem: moved along, the first
    # measurement and k more have the posterior mean of k + 1 equal measurements, and its variance.
    noise, num_steps, num_runs = 0.2, 3, 40
    model = parking(num_particles=4000, problem={"position_noise": noise, "heading_noise": 1e-4})
    start, action = jnp.asarray([-2.0, 0.5, 0.0]), jnp.zeros(2)

    @jax.jit
    def run(key):
        key_prior, key = jax.random.split(key)

        def advance(carry, step):
            world, belief = carry
            key_world, key_filter = jax.random.split(jax.random.fold_in(key, step))
            world, observation, _ = model.execute(key_world, world, action)
            return (world, model.update(belief, action, observation, key_filter)), None

        before = start, model.prior(key_prior, start, 1)
        world, belief = jax.lax.scan(advance, before, jnp.arange(num_steps, dtype=jnp.uint32))[0]
        return belief.mean[:2] - world[:2], jnp.diagonal(belief.covariance)[:2]

    errors, variances = jax.vmap(run)(jax.random.split(jax.random.key(5), num_runs))
    expected = noise**2 / (num_steps + 1)
    np.testing.assert_allclose(np.mean(variances), expected, rtol=0.05)
    # 80 errors: their mean square is chi-squared.
    share = np.sum(np.asarray(errors) ** 2) / expected
    assert stats.chi2.ppf(1e-4, errors.size) < share < stats.chi2.ppf(1 - 1e-4, errors.size)


def test_the_first_belief_has_no_pose_outside_the_domain():
    model = parking(num_particles=500, problem={"position_noise": 0.5})
    pose = jnp.asarray([3.9, -3.9, 0.0])
    states = np.asarray(eqx.filter_jit(model.prior)(jax.random.key(6), pose, 1).states)
    assert np.abs(states[:, :2]).max() <= 4.0
    assert len(np.unique(states[:, 0])) > 50
    # The same measurement, without the border: a share of those poses lies outside.
    free = parking(num_particles=500, problem={"position_noise": 0.5, "exit_terminates": False})
    states = np.asarray(eqx.filter_jit(free.prior)(jax.random.key(6), pose, 1).states)
    assert np.abs(states[:, :2]).max() > 4.0


def test_success_is_that_of_the_last_pose():
    model = parking(num_particles=8)
    belief = eqx.filter_jit(model.prior)(jax.random.key(0), jnp.zeros(3), 1)
    assert model.summary({}, jnp.zeros(3), belief)["success"]
    assert not model.summary({}, jnp.asarray([0.2, 0.0, 0.0]), belief)["success"]


def test_other_problems_and_vehicles_are_refused():
    with pytest.raises(ConfigError, match=r"problem\.vehicle: got WheeledRobot; allowed: exact"):
        build(UncertainPose.model_validate({"problem": "robot-parking"}))
    with pytest.raises(ValueError, match="vdp-tag"):
        UncertainPose.model_validate({"problem": "vdp-tag"})


def test_a_draw_before_any_measurement_is_a_start():
    model = parking()
    states = particles.initial(model, jax.random.key(7), 2000).states
    assert stats.kstest(np.asarray(states[:, 0]), "uniform", (-4.0, 8.0)).pvalue > 1e-4
