"""A belief as an environment: summaries against NumPy, dynamics of its problems, mistakes in settings."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.envs.settings import Belief, MountainCar
from bojax.experiments.settings import Learning
from bojax.problems.pomdp.settings import Hallway, LightDark, PomdpMountainCar
from bojax.problems.state_space import COLLAPSES
from tests.refusals import assert_refused

CAR = {"problem": PomdpMountainCar(num_particles=50), "low": (-1.2, -0.07), "high": (0.6, 0.07)}


@eqx.filter_jit
def reset(env, key):
    return env.reset(key)


@eqx.filter_jit
def step(env, key, state, action):
    return env.step(key, state, action)


@eqx.filter_jit
def begun(run, key):
    return run.init(key)


@eqx.filter_jit
def advanced(run, carry):
    carry = run.advance(carry)[0]
    return carry, run.summary(carry)


def test_what_is_observed_summarises_the_belief():
    env = build(Belief(**CAR))
    state = reset(env, jax.random.key(0))
    for time in range(3):
        state, after = step(env, jax.random.key(time), state, jnp.ones(1))
    weights = np.exp(np.asarray(state.belief.log_weights))
    mean = weights @ np.asarray(state.belief.states)
    spread = np.sqrt(weights @ (np.asarray(state.belief.states) - mean) ** 2)
    np.testing.assert_allclose(after.observation, np.concatenate([mean, spread]))
    space = env.observation_space
    np.testing.assert_allclose(space.high, [0.6, 0.07, 1.8 / np.sqrt(12), 0.14 / np.sqrt(12)])
    # The filter has seen three positions: it is near the truth, which it does not contain.
    states, world = np.asarray(state.belief.states), np.asarray(state.world)
    assert np.abs(mean - world)[0] < 0.1 and not np.any(np.all(states == world, axis=1))
    for features, expected in (("mean", mean), ("state", state.world)):
        np.testing.assert_allclose(build(Belief(**CAR, features=features)).observe(state), expected)


def test_the_reading_alone_is_the_last_observation():
    env = build(
        Belief(problem=Hallway(num_particles=20), features="reading", low=(0.0, 0.0), high=(1.0, 1.0))
    )
    state = reset(env, jax.random.key(1))
    np.testing.assert_array_equal(env.observe(state), [0.5, 0.5])
    _, after = step(env, jax.random.key(2), state, jnp.ones(1))
    assert set(np.asarray(after.observation).tolist()) <= {0.0, 1.0}


@pytest.mark.parametrize("sensor_noise, collapses", [(1e-200, 8), (0.1, 0)])
def test_collapses_are_counted_in_training(sensor_noise, collapses):
    car = CAR["problem"].model_copy(update={"sensor_noise": sensor_noise, "max_steps": 4})
    settings = {
        "env": Belief(**(CAR | {"problem": car})),
        "learner": "random",
        "episodes": 2,
        "tests": 1,  # which count for nothing
    }
    run = build(Learning(**settings))
    assert COLLAPSES in run.tables["runs"]
    carry = begun(run, jax.random.key(0))
    for _ in range(3):  # the third finds the run done
        carry, summary = advanced(run, carry)
    assert int(summary["collapses"]) == collapses


def test_a_stop_at_the_right_door_succeeds():
    env = build(Belief(problem=Hallway(num_particles=20)))
    state = reset(env, jax.random.key(0))
    for position, reward, success in ((7.2, 1.0, True), (4.0, -1.0, False)):
        at = state.__class__(jnp.full(1, position), state.belief, state.reading)
        _, after = step(env, jax.random.key(3), at, jnp.zeros(1))
        assert (float(after.reward), bool(after.success), bool(after.terminated)) == (reward, success, True)
    _, after = step(env, jax.random.key(3), state, jnp.ones(1))
    assert (float(after.reward), bool(after.terminated)) == (0.0, False)


def test_the_list_of_a_problem_is_a_discrete_space():
    env = build(Belief(problem=LightDark(num_particles=20), low=(-60.0,), high=(60.0,)))
    assert env.action_space.num == 5
    state = reset(env, jax.random.key(0))
    after, _ = step(env, jax.random.key(1), state, jnp.asarray(4, jnp.int32))
    np.testing.assert_allclose(after.world, state.world + 10.0)


def test_without_noise_the_car_is_the_environment_mountain_car():
    car, env = build(PomdpMountainCar(velocity_noise=0.0)), build(MountainCar())
    rng = np.random.default_rng(0)
    for _ in range(20):
        state = jnp.asarray(rng.uniform([-1.2, -0.07], [0.6, 0.07]))
        action = jnp.asarray(rng.uniform(-1.0, 1.0, 1))
        after, reward, terminated = step(car, jax.random.key(0), state, action)
        expected, time_step = step(env, jax.random.key(0), state, action)
        np.testing.assert_array_equal(after, expected)
        assert float(reward) == float(time_step.reward) and bool(terminated) == bool(time_step.terminated)


def test_wrong_bounds_and_problems_are_refused():
    assert_refused(
        (
            (lambda: build(Belief(problem=CAR["problem"])), r"env\.low: got 1 numbers; allowed: 2"),
            (lambda: build(Belief(**CAR, features="reading")), r"env\.low: got 2 numbers; allowed: 1"),
        )
    )
    with pytest.raises(ValueError, match="parking"):
        Belief.model_validate({"problem": "parking"})
