"""What every problem of poses has in common: readings, driving, and simulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.motions.base import place
from tests.motions.families import FAMILIES, all_paths, wrapped
from tests.planning.samples import parking
from tests.problems.goal_disc import goal_disc

PROBLEMS = {
    "parking": parking(),
    "parking-on": parking(exit_terminates=False, rule="anywhere-bearing-dropped"),
    "disc": goal_disc(),
}
each_problem = pytest.mark.parametrize("name", PROBLEMS)

NUM = 3000


def on_host(function):
    """The function, compiled, with results in NumPy."""
    compiled = jax.jit(function)
    return lambda *args: jax.device_get(compiled(*args))


execute = on_host(lambda problem, keys, worlds, paths: jax.vmap(problem.execute)(keys, worlds, paths))
outcomes = on_host(lambda problem, starts, paths: jax.vmap(problem.outcome)(starts, paths))
placed = on_host(jax.vmap(place))


def keys_of(seed: int):
    return jax.random.split(jax.random.key(seed), NUM)


def drives(horizon: int = 1):
    """Poses of the domain of parking, and a sequence of paths for each."""
    rng = np.random.default_rng(0)
    worlds = rng.uniform([-4.0, -4.0, 0.0], [4.0, 4.0, 2.0 * np.pi], (NUM, 3))
    worlds[::2] *= [0.2, 0.2, 1.0]  # many of them near the goal
    library = all_paths(FAMILIES["kernel"])
    paths = library[rng.integers(len(library), size=(NUM, horizon))]
    return worlds, paths[:, 0] if horizon == 1 else paths


@each_problem
def test_driving_is_the_outcome_of_the_placed_path(name):
    worlds, paths = drives()
    ends, _, events = execute(PROBLEMS[name], keys_of(0), worlds, paths)
    poses = placed(paths, worlds)
    expected = outcomes(PROBLEMS[name], worlds, poses)
    np.testing.assert_allclose(events.reward, expected.reward, atol=1e-12)
    for field in ("terminated", "success", "exited"):
        np.testing.assert_array_equal(getattr(events, field), getattr(expected, field))
    # Up to the last pose the robot drives the path, then it stays.
    last = np.asarray(expected.last)
    index = np.minimum(np.arange(poses.shape[1])[None], last[:, None])
    driven = np.take_along_axis(np.asarray(poses), index[..., None], axis=1)
    np.testing.assert_allclose(events.driven, driven, atol=1e-14)
    np.testing.assert_allclose(ends[:, :2], driven[:, -1, :2], atol=1e-14)
    assert np.all(ends[:, 2] >= 0.0) and np.all(ends[:, 2] < 2.0 * np.pi)
    np.testing.assert_allclose(wrapped(np.asarray(ends[:, 2] - events.driven[:, -1, 2])), 0.0, atol=1e-12)
    assert np.any(last < poses.shape[1] - 1) and np.any(np.asarray(expected.success))


def test_readings_have_the_stated_standard_deviations():
    problem = parking(position_noise=0.02, heading_noise=0.3)
    worlds, paths = drives()
    first = jax.jit(jax.vmap(lambda key, world: problem.prior(key, world, 10)))(keys_of(0), worlds) - worlds
    ends, readings, _ = execute(problem, keys_of(1), worlds, paths)
    for noise in (first, readings - ends):
        scaled = np.asarray(noise) / [0.02, 0.02, 0.3]
        for axis in range(3):
            assert stats.kstest(scaled[:, axis], "norm").pvalue > 1e-3
        assert np.abs(np.corrcoef(scaled.T) - np.eye(3)).max() < 0.07


@each_problem
def test_the_belief_is_the_last_reading(name):
    problem, reading = PROBLEMS[name], jnp.asarray([1.0, 2.0, 3.0])
    belief = problem.update(jnp.zeros(3), jnp.zeros((8, 3)), reading)
    _, node = problem.root(belief, 3)
    np.testing.assert_array_equal(belief, reading)
    np.testing.assert_array_equal(node, reading)


@on_host
def simulate(problem, keys, nodes, plans):
    """Each plan played on its node."""
    return jax.vmap(lambda *each: problem.simulate(each[0], None, *each[1:], None))(keys, nodes, plans)


@each_problem
def test_simulating_is_driving_without_noise_until_the_end(name):
    starts, plans = drives(horizon=3)
    found = simulate(PROBLEMS[name], keys_of(0), starts, plans)
    poses, running = starts, np.ones(NUM, bool)
    for step in range(3):
        path = placed(plans[:, step], poses)
        expected = outcomes(PROBLEMS[name], poses, path)
        np.testing.assert_allclose(found.rewards[running, step], expected.reward[running], atol=1e-12)
        np.testing.assert_array_equal(found.terminated[running, step], expected.terminated[running])
        running = running & ~np.asarray(expected.terminated)
        poses = path[:, -1]
        if step == 0:
            np.testing.assert_allclose(found.node[running], poses[running], atol=1e-12)
    assert 0 < running.sum() < NUM
