"""The continuous domains against Gymnasium, step by step, and against what the thesis says of their goals."""

from dataclasses import fields
from math import pi
from typing import Literal

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.engine.build import build
from bojax.envs import settings as envs
from bojax.envs.mountain_car import MountainCar

SCHEMAS = (envs.SinglePendulum, envs.MountainCar, envs.DoublePendulum, envs.CartpoleSwingUp)
VARIANTS = [
    envs.SinglePendulum(),
    envs.SinglePendulum(reward="classic"),
    envs.SinglePendulum(reward="classic", classic_ends_at_goal=False),
    envs.MountainCar(),
    envs.MountainCar(reward="classic", actions="thresholded"),
    envs.DoublePendulum(),
    envs.DoublePendulum(reward="classic", actuated="elbow", goal="height", actions="sign"),
    envs.CartpoleSwingUp(),
    envs.CartpoleSwingUp(reward="classic", actions="sign"),
]
TOLERANCE = {"float64": 1e-12, "float32": 3e-5}


def describe(schema) -> str:
    settings = schema.model_dump(exclude_defaults=True)
    return "-".join([schema.kind, *(str(value) for value in settings.values())])


@eqx.filter_jit
def step(env, states, actions):
    """Many steps at once: the states after, and the transitions."""
    return jax.vmap(lambda s, a: env.step(jax.random.key(0), s, a))(states, actions)


@eqx.filter_jit
def reset(env, key, num):
    return jax.vmap(env.reset)(jax.random.split(key, num))


@eqx.filter_jit
def rollout(env, state, actions):
    """The states before each step, and the transitions."""

    def go_on(state, action):
        after, transition = env.step(jax.random.key(0), state, action)
        return after, (state, transition)

    return jax.lax.scan(go_on, state, actions)[1]


def one_step(schema, state, action, dtype="float64"):
    """What one step leads to, as Python numbers."""
    states = jnp.asarray([state], dtype)
    _, transition = step(build(schema, dtype), states, jnp.asarray([[action]], dtype))
    return jax.tree.map(lambda x: x[0].item() if x.ndim == 1 else np.asarray(x[0]), transition)


def visited(schema, num=400, seed=0):
    """States of a domain and actions in them: some of a rollout, some anywhere within the bounds."""
    env, rng = build(schema), np.random.default_rng(seed)
    space, actions = env.observation_space, env.action_space
    drawn = rng.uniform(actions.low, actions.high, (num, 1))
    start = reset(env, jax.random.key(seed), 1)[0]
    driven = np.asarray(rollout(env, start, jnp.asarray(drawn[: num // 2]))[0])
    anywhere = {
        "single-pendulum": ([-pi, -8.0], [pi, 8.0]),
        "double-pendulum": ([-pi, -pi, -4 * pi, -9 * pi], [pi, pi, 4 * pi, 9 * pi]),
    }.get(schema.kind, (space.low, space.high))
    return np.concatenate([driven, rng.uniform(*anywhere, (num // 2, driven.shape[1]))]), drawn


def gym_steps(name, states, actions, **kwargs):
    """The same steps in Gymnasium: states after, rewards, terminations."""
    env = gymnasium.make(name, **kwargs).unwrapped
    env.reset(seed=0)
    after, rewards, ends = [], [], []
    for state, action in zip(states, actions, strict=True):
        env.state = np.array(state)
        env.steps_beyond_terminated = None
        _, reward, terminated, _, _ = env.step(action)
        after.append(np.array(env.state, np.float64))
        rewards.append(reward)
        ends.append(terminated)
    return np.array(after), np.array(rewards, np.float64), np.array(ends)


def assert_same_states(ours, theirs, angles, atol):
    gap = np.asarray(ours, np.float64) - theirs
    gap[:, angles] = (gap[:, angles] + pi) % (2 * pi) - pi
    assert np.abs(gap).max() < atol


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_single_pendulum_moves_and_pays_as_in_gymnasium(dtype):
    schema = envs.SinglePendulum(reward="classic", classic_ends_at_goal=False)
    states, actions = visited(schema)
    actions = 1.3 * actions  # some beyond the bounds
    after, rewards, ends = gym_steps("Pendulum-v1", states, actions)
    ours, transition = step(build(schema, dtype), jnp.asarray(states, dtype), jnp.asarray(actions, dtype))
    assert_same_states(ours, after, [0], TOLERANCE[dtype])
    np.testing.assert_allclose(transition.reward, rewards, atol=TOLERANCE[dtype])
    np.testing.assert_array_equal(transition.terminated, ends)
    expected = np.stack([np.cos(after[:, 0]), np.sin(after[:, 0]), after[:, 1]], axis=-1)
    np.testing.assert_allclose(transition.observation, expected, atol=TOLERANCE[dtype])


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_mountain_car_with_thresholded_actions_is_gymnasiums(dtype):
    schema = envs.MountainCar(reward="classic", actions="thresholded")
    states, actions = visited(schema)
    states[:40, 0] = np.linspace(-1.2, -1.15, 40)  # at the left wall
    states[:40, 1] = -0.06
    discrete = np.where(np.abs(actions[:, 0]) < 0.33, 1, np.where(actions[:, 0] < 0, 0, 2))
    after, rewards, ends = gym_steps("MountainCar-v0", states, discrete, goal_velocity=-np.inf)
    ours, transition = step(build(schema, dtype), jnp.asarray(states, dtype), jnp.asarray(actions, dtype))
    assert_same_states(ours, after, [], TOLERANCE[dtype])
    np.testing.assert_array_equal(transition.reward, rewards)
    np.testing.assert_array_equal(transition.terminated, ends)
    at_the_wall = after[:, 0] == -1.2
    assert at_the_wall.sum() > 30 and not np.any(np.asarray(ours)[at_the_wall, 1])
    assert 10 < ends.sum() < 200


def test_mountain_car_with_continuous_actions_is_gymnasiums():
    schema = envs.MountainCar(power=0.0015, goal_position=0.45)
    states, actions = visited(schema)
    states[:40, 0] = np.linspace(-1.2, -1.15, 40)
    states[:40, 1] = -0.06
    after, _, ends = gym_steps("MountainCarContinuous-v0", states, 1.3 * actions, goal_velocity=-np.inf)
    ours, transition = step(build(schema), jnp.asarray(states), jnp.asarray(1.3 * actions))
    assert_same_states(ours, after, [], 1e-7)  # Gymnasium keeps this state in float32
    np.testing.assert_array_equal(transition.success, ends)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_double_pendulum_driven_at_the_elbow_is_gymnasiums(dtype):
    schema = envs.DoublePendulum(reward="classic", actuated="elbow", goal="height", actions="sign")
    states, actions = visited(schema)
    after, rewards, ends = gym_steps("Acrobot-v1", states, np.where(actions[:, 0] < 0, 0, 2))
    ours, transition = step(build(schema, dtype), jnp.asarray(states, dtype), jnp.asarray(actions, dtype))
    tolerance = {"float64": 1e-11, "float32": 1e-3}[dtype]  # a step at 28 rad/s turns by 5.6 rad
    assert_same_states(ours, after, [0, 1], tolerance)
    if dtype == "float64":
        np.testing.assert_array_equal(transition.reward, rewards)
        np.testing.assert_array_equal(transition.terminated, ends)
    assert 10 < ends.sum() < 200


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_cartpole_moves_as_in_gymnasium(dtype):
    schema = envs.CartpoleSwingUp(actions="sign")
    states, actions = visited(schema)
    after, _, _ = gym_steps("CartPole-v1", states, (actions[:, 0] >= 0).astype(int))
    ours, _ = step(build(schema, dtype), jnp.asarray(states, dtype), jnp.asarray(actions, dtype))
    assert_same_states(ours, after, [], TOLERANCE[dtype])


def test_cartpole_with_a_continuous_force_is_the_one_with_signs_at_its_bounds():
    states, actions = visited(envs.CartpoleSwingUp())
    force = np.where(actions < 0, -10.0, 10.0)
    by_sign, _ = step(build(envs.CartpoleSwingUp(actions="sign")), jnp.asarray(states), jnp.asarray(actions))
    by_force, _ = step(build(envs.CartpoleSwingUp()), jnp.asarray(states), jnp.asarray(force))
    half, _ = step(build(envs.CartpoleSwingUp()), jnp.asarray(states), jnp.asarray(0.5 * force))
    rest, _ = step(build(envs.CartpoleSwingUp()), jnp.asarray(states), jnp.zeros_like(force))
    np.testing.assert_array_max_ulp(np.asarray(by_sign), np.asarray(by_force), maxulp=2)
    np.testing.assert_allclose(half - rest, 0.5 * (by_force - rest), atol=1e-12)  # linear in the force


def lagrangian(q, v):
    """Of two 1 m rods of 1 kg with a moment of inertia of 1 kg m^2 about their centres; q from hanging."""

    def centre(q):
        elbow = jnp.stack([jnp.sin(q[0]), -jnp.cos(q[0])])
        along = jnp.stack([jnp.sin(q[0] + q[1]), -jnp.cos(q[0] + q[1])])
        return jnp.stack([0.5 * elbow, elbow + 0.5 * along])

    velocity = jax.jvp(centre, (q,), (v,))[1]
    kinetic = 0.5 * jnp.sum(velocity**2) + 0.5 * (v[0] ** 2 + (v[0] + v[1]) ** 2)
    return kinetic - 9.8 * jnp.sum(centre(q)[:, 1])


@pytest.mark.parametrize(("joint", "force"), [("base", (1.0, 0.0)), ("elbow", (0.0, 1.0))])
def test_the_double_pendulum_obeys_lagranges_equations(joint, force):
    """d/dt dL/dv - dL/dq = torque, with the derivatives taken by JAX."""
    states, actions = visited(envs.DoublePendulum(), num=60)
    env = build(envs.DoublePendulum(actuated=joint))

    def acceleration(state, action):
        q, v = state[:2], state[2:]
        momentum = jax.grad(lagrangian, 1)
        moved = jax.jvp(lambda q: momentum(q, v), (q,), (v,))[1]
        right = jax.grad(lagrangian)(q, v) - moved + jnp.asarray(force) * action
        return jnp.linalg.solve(jax.jacfwd(momentum, 1)(q, v), right)

    expected = jax.jit(jax.vmap(acceleration))(jnp.asarray(states), jnp.asarray(actions))
    found = jax.jit(jax.vmap(env.velocity))(jnp.asarray(states), jnp.asarray(actions)[:, 0])
    np.testing.assert_allclose(found[:, :2], states[:, 2:])
    np.testing.assert_allclose(found[:, 2:], expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("schema", VARIANTS, ids=describe)
def test_rewards_and_ends_are_those_of_the_docstring(schema, dtype):
    states, actions = visited(schema)
    states[-100:, :2] *= 0.3
    env = build(schema, dtype)
    after, transition = step(env, jnp.asarray(states, dtype), jnp.asarray(actions, dtype))
    observation = transition.observation
    assert after.dtype == observation.dtype == transition.reward.dtype == dtype
    assert observation.shape[1:] == env.observation_space.low.shape
    reward, success, ends = map(np.asarray, (transition.reward, transition.success, transition.terminated))
    failure = np.abs(after[:, 0]) > 2.4 if schema.kind == "cartpole-swing-up" else np.zeros_like(success)
    assert np.all(ends[success]) or not getattr(schema, "classic_ends_at_goal", True)
    assert not np.any(success & failure) and not np.any(transition.truncated)
    if schema.reward == "goal-only":
        np.testing.assert_array_equal(reward, success.astype(float) - failure)
        np.testing.assert_array_equal(ends, success | failure)
    elif schema.kind == "cartpole-swing-up":
        np.testing.assert_array_equal(ends, success | failure)
        shaped = np.cos(np.asarray(after)[:, 2]) - 1.0
        np.testing.assert_allclose(
            reward, np.select([failure, success], [-100.0, 0.0], shaped), atol=1e-6, rtol=1e-6
        )
        assert failure.sum() > 10
    assert success.sum() > 3


def test_the_pendulum_is_upright_within_its_angle():
    def upright(angle, **settings):
        return one_step(envs.SinglePendulum(gravity=0.0, **settings), [angle, 0.0], 0.0).success

    assert upright(0.0499) and upright(-0.0499) and upright(2 * pi - 0.0499)
    assert not upright(0.0501) and not upright(-0.0501) and not upright(pi)
    assert upright(0.19, goal_angle=0.2)


class Own(MountainCar):
    """A task of one's own, which declares the reward as the page on robots does."""

    reward: Literal["goal-only", "classic"] = eqx.field(static=True)


@pytest.mark.parametrize("reward", ["goal-only", "classic"])
def test_a_task_may_declare_its_reward_as_text(reward):
    car = build(envs.MountainCar())
    settings = {field.name: getattr(car, field.name) for field in fields(car)}
    _, transition = Own(**settings | {"reward": reward}).step(
        jax.random.key(0), jnp.asarray([-0.5, 0.0]), jnp.ones(1)
    )
    assert transition.reward == (0.0 if reward == "goal-only" else -1.0)


def test_the_car_reaches_either_goal():
    at = [0.4199, 0.001]
    assert not one_step(envs.MountainCar(), at, 1.0).success
    assert one_step(envs.MountainCar(goal_position=0.42), at, 1.0).success
    assert one_step(envs.MountainCar(), [0.49, 0.02], 0.0).success


def test_goal_distance_and_goal_height_are_different_sets():
    # One tip at (sin 1.2, 1 + cos 1.2) = (0.93, 1.36): high, but 1.13 m from the highest point.
    beside, high = [pi - 1.2, 1.2, 0.0, 0.0], [pi, 0.01, 0.0, 0.0]
    for settings, expected in (({"goal": "distance"}, False), ({"goal": "height"}, True)):
        schema = envs.DoublePendulum(time_step=1e-6, **settings)
        assert one_step(schema, beside, 0.0).success is expected
        assert one_step(schema, high, 0.0).success is True
        assert one_step(schema, [0.0, 0.0, 0.0, 0.0], 0.0).success is False


def test_a_cart_that_leaves_fails_even_with_its_pole_up():
    leaves = one_step(envs.CartpoleSwingUp(), [2.39, 1.0, 0.1, 0.0], 0.0)
    assert (leaves.reward, leaves.terminated, leaves.success) == (-1.0, True, False)
    stays = one_step(envs.CartpoleSwingUp(limit=3.0), [2.39, 1.0, 0.1, 0.0], 0.0)
    assert (stays.reward, stays.terminated, stays.success) == (1.0, True, True)
    left = one_step(envs.CartpoleSwingUp(reward="classic"), [-2.39, -1.0, pi, 0.0], 0.0)
    assert (left.reward, left.terminated, left.success) == (-100.0, True, False)


@pytest.mark.parametrize("schema", [s() for s in SCHEMAS], ids=describe)
def test_actions_outside_the_bounds_are_clipped(schema):
    states, actions = visited(schema, num=40)
    env = build(schema)
    bound = jnp.where(actions < 0, env.action_space.low, env.action_space.high)
    inside, outside = (step(env, jnp.asarray(states), a) for a in (bound, 7.0 * bound))
    np.testing.assert_array_equal(inside[0], outside[0])
    np.testing.assert_array_equal(inside[1].observation, outside[1].observation)


@pytest.mark.parametrize(
    ("schema", "low", "high"),
    [
        (envs.SinglePendulum(), [-pi, -1.0], [pi, 1.0]),
        (envs.MountainCar(), [-0.6, None], [-0.4, None]),
        (envs.DoublePendulum(), [-0.1] * 4, [0.1] * 4),
        (envs.CartpoleSwingUp(), [-0.05, -0.05, pi - 0.05, -0.05], [0.05, 0.05, pi + 0.05, 0.05]),
    ],
    ids=lambda part: part.kind if hasattr(part, "kind") else "",
)
def test_episodes_begin_as_in_gym(schema, low, high):
    states = np.asarray(reset(build(schema), jax.random.key(3), 2000))
    for column, least, most in zip(states.T, low, high, strict=True):
        if least is None:
            np.testing.assert_array_equal(column, 0.0)
        else:
            assert stats.kstest(column, "uniform", args=(least, most - least)).pvalue > 1e-3
    drawn = states[:, [least is not None for least in low]].T
    correlation = np.atleast_2d(np.corrcoef(drawn)) - np.eye(len(drawn))
    assert np.abs(correlation).max() < 0.08  # no number is drawn from the key of another
