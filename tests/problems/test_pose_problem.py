"""What every problem of poses has in common: readings, driving, and simulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.motions.base import place
from tests.motions.families import FAMILIES, all_paths, wrapped
from tests.problems.goal_disc import goal_disc
from tests.problems.parking_reference import Settings
from tests.problems.test_parking import parking

PROBLEMS = {"parking": parking(), "parking-on": parking(Settings(exit_terminates=False)), "disc": goal_disc()}
each_problem = pytest.mark.parametrize("name", PROBLEMS)
LIBRARY = all_paths(FAMILIES["kernel"])

execute = jax.jit(lambda problem, keys, worlds, paths: jax.vmap(problem.execute)(keys, worlds, paths))
outcomes = jax.jit(lambda problem, starts, paths: jax.vmap(problem.outcome)(starts, paths))


def drives(num: int, seed: int = 0):
    """Poses of a square a little beyond the domain of parking, and a path for each."""
    rng = np.random.default_rng(seed)
    worlds = rng.uniform([-4.0, -4.0, 0.0], [4.0, 4.0, 2.0 * np.pi], (num, 3))
    worlds[::2] *= [0.2, 0.2, 1.0]  # many of them near the goal
    return jnp.asarray(worlds), jnp.asarray(LIBRARY[rng.integers(len(LIBRARY), size=num)])


@each_problem
def test_driving_is_the_outcome_of_the_placed_path(name):
    worlds, paths = drives(300)
    keys = jax.random.split(jax.random.key(0), 300)
    ends, _, events = execute(PROBLEMS[name], keys, worlds, paths)
    placed = jax.vmap(place)(paths, worlds)
    expected = outcomes(PROBLEMS[name], worlds, placed)
    np.testing.assert_allclose(events.reward, expected.reward, atol=1e-12)
    for field in ("terminated", "success", "exited"):
        np.testing.assert_array_equal(getattr(events, field), getattr(expected, field))
    last = np.asarray(expected.last)
    for lane in range(300):
        driven = np.asarray(events.driven[lane])
        np.testing.assert_allclose(driven[: last[lane] + 1], placed[lane, : last[lane] + 1], atol=1e-14)
        stays = np.tile(driven[last[lane]], (8 - last[lane], 1))
        np.testing.assert_allclose(driven[last[lane] :], stays, atol=1e-14)
    np.testing.assert_allclose(ends[:, :2], events.driven[:, -1, :2], atol=1e-14)
    assert np.any(last < 7) and np.any(np.asarray(expected.success))


@each_problem
def test_the_heading_of_the_world_is_wrapped(name):
    worlds, paths = drives(300)
    ends, _, events = execute(PROBLEMS[name], jax.random.split(jax.random.key(0), 300), worlds, paths)
    assert np.all(ends[:, 2] >= 0.0) and np.all(ends[:, 2] < 2.0 * np.pi)
    np.testing.assert_allclose(wrapped(np.asarray(ends[:, 2] - events.driven[:, -1, 2])), 0.0, atol=1e-12)


def test_readings_have_the_stated_standard_deviations():
    problem = parking(position_noise=0.02, heading_noise=0.3)
    keys = jax.random.split(jax.random.key(0), 4000)
    world = jnp.asarray([1.0, -2.0, 0.1])
    first = np.asarray(jax.jit(jax.vmap(lambda key: problem.prior(key, world)))(keys)) - np.asarray(world)
    worlds, paths = drives(4000)
    ends, readings, _ = execute(problem, jax.random.split(jax.random.key(1), 4000), worlds, paths)
    for noise in (first, np.asarray(readings - ends)):
        scaled = noise / [0.02, 0.02, 0.3]
        for axis in range(3):
            assert stats.kstest(scaled[:, axis], "norm").pvalue > 1e-3
        assert np.abs(np.corrcoef(scaled.T) - np.eye(3)).max() < 0.06


def test_without_noise_a_reading_is_the_pose():
    worlds, paths = drives(20)
    problem = parking(position_noise=0.0, heading_noise=0.0)
    ends, readings, _ = execute(problem, jax.random.split(jax.random.key(0), 20), worlds, paths)
    np.testing.assert_allclose(readings, ends, atol=1e-14)


@each_problem
def test_the_belief_is_the_last_reading(name):
    problem, reading = PROBLEMS[name], jnp.asarray([1.0, 2.0, 3.0])
    belief = problem.update(jnp.zeros(3), jnp.asarray(LIBRARY[0]), reading)
    _, node = problem.root(belief, 3)
    np.testing.assert_array_equal(belief, reading)
    np.testing.assert_array_equal(node, reading)


@each_problem
@pytest.mark.parametrize("horizon", [1, 3])
def test_simulating_is_driving_without_noise_until_the_end(name, horizon):
    problem = PROBLEMS[name]
    starts, _ = drives(200)
    rng = np.random.default_rng(1)
    plans = jnp.asarray(LIBRARY[rng.integers(len(LIBRARY), size=(200, horizon))])
    simulate = jax.vmap(lambda key, node, paths: problem.simulate(key, None, node, paths, None))
    found = jax.jit(simulate)(jax.random.split(jax.random.key(0), 200), starts, plans)
    poses, running = np.asarray(starts), np.ones(200, bool)
    for step in range(horizon):
        placed = jax.vmap(place)(plans[:, step], jnp.asarray(poses))
        expected = outcomes(problem, jnp.asarray(poses), placed)
        np.testing.assert_allclose(
            np.asarray(found.rewards[:, step])[running], np.asarray(expected.reward)[running], atol=1e-12
        )
        np.testing.assert_array_equal(
            np.asarray(found.terminated[:, step])[running], np.asarray(expected.terminated)[running]
        )
        running = running & ~np.asarray(expected.terminated)
        poses = np.asarray(placed[:, -1])
        if step == 0:
            np.testing.assert_allclose(np.asarray(found.node)[running], poses[running], atol=1e-12)
    assert 0 < running.sum() < 200


def test_a_simulated_path_is_one_executed_from_a_perfect_reading():
    problem = parking(position_noise=0.0, heading_noise=0.0)
    worlds, paths = drives(200)
    ends, readings, events = execute(problem, jax.random.split(jax.random.key(0), 200), worlds, paths)
    simulate = jax.vmap(lambda key, node, path: problem.simulate(key, None, node, path[None], None))
    found = jax.jit(simulate)(jax.random.split(jax.random.key(1), 200), worlds, paths)
    np.testing.assert_allclose(found.rewards[:, 0], events.reward, atol=1e-12)
    np.testing.assert_array_equal(found.terminated[:, 0], events.terminated)
