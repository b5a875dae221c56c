"""Brax's environments as ours, beside Brax itself; and ours under Brax's wrappers."""

import subprocess
import sys

import brax.envs as brax_envs
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.wrappers import training

from bojax.config.errors import ConfigError
from bojax.engine.build import build
from bojax.envs import settings as envs
from bojax.envs.brax import BojaxEnv, BraxEnv
from bojax.numerics.third_party import plain_jax
from tests.refusals import one_line


class Spring(brax_envs.Env):
    """A weight on a spring, written as Brax environments are: types and ranks are promoted."""

    def __init__(self, backend="mjx", as_mapping=False):
        self.as_mapping = as_mapping

    def reset(self, rng):
        x = jax.random.uniform(rng, (2,), minval=-1)
        return brax_envs.State(x, self._seen(x), jnp.zeros(()), jnp.zeros(()), {}, {"rng": rng, "n": 0})

    def step(self, state, action):
        x = state.pipeline_state
        x = jnp.array([x[0] + 0.1 * x[1], x[1] - x[0] + 5 * action[0] - 0])
        reward = jnp.sum(x * jnp.ones((1, 2)))
        info = {"rng": state.info["rng"], "n": state.info["n"] + 1}
        done = jnp.where(jnp.abs(x[0]) > 2, 1.0, 0.0)
        return brax_envs.State(x, self._seen(x), reward, done, {}, info)

    def _seen(self, x):
        return {"x": x} if self.as_mapping else x

    observation_size, action_size, backend = 2, 1, "none"


@pytest.fixture
def spring(monkeypatch):
    monkeypatch.setitem(brax_envs._envs, "spring", Spring)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_brax_environment_takes_the_steps_that_it_takes_in_brax(spring, dtype):
    env = build(envs.Brax(name="spring", success_reward=1.0), dtype)
    actions = jnp.asarray(np.random.default_rng(0).uniform(-1.5, 1.5, (30, 1)), dtype)

    def rollout(key):
        def go_on(state, action):
            return env.step(key, state, action)

        state = env.reset(key)
        return env.observe(state), jax.lax.scan(go_on, state, actions)[1]

    keys = jax.random.split(jax.random.key(0), 2)
    first, found = jax.device_get(jax.jit(jax.vmap(rollout))(keys))
    assert first.dtype == found.observation.dtype == found.reward.dtype == dtype
    for lane in range(2):
        with plain_jax():
            theirs = Spring()
            step = jax.jit(theirs.step)
            state = jax.jit(theirs.reset)(jax.random.key_data(keys[lane]))
            np.testing.assert_allclose(first[lane], state.obs, rtol=1e-6)
            for i, action in enumerate(np.clip(np.asarray(actions, np.float32), -1.0, 1.0)):
                state = step(state, action)
                np.testing.assert_allclose(found.observation[lane, i], state.obs, rtol=1e-4, atol=1e-5)
                np.testing.assert_allclose(found.reward[lane, i], state.reward, rtol=1e-4, atol=1e-5)
                assert found.terminated[lane, i] == bool(state.done)
                assert found.success[lane, i] == (state.reward >= 1.0)
    assert found.terminated.any() and found.success.any() and not found.success.all()


def test_a_lane_can_be_held(spring):
    """What the engine does with a lane that has ended: the old state and the new one are of one type."""
    env = build(envs.Brax(name="spring"), "float32")
    state = jax.eval_shape(env.reset, jax.random.key(0))
    after, _ = jax.eval_shape(env.step, jax.random.key(1), state, jnp.ones(1, jnp.float32))
    old, new = (jax.tree.map(lambda x: (x.dtype, x.shape, x.weak_type), tree) for tree in (state, after))
    assert old == new


def test_mjx_is_traced_as_a_32_bit_program():
    env = build(envs.Brax(name="inverted_pendulum", low=-5.0, high=[1.0, 2.0, 3.0, 4.0]), "float64")
    assert env.action_space.num_dims == 1
    np.testing.assert_array_equal(env.observation_space.low, [-5.0] * 4)
    np.testing.assert_array_equal(env.observation_space.high, [1.0, 2.0, 3.0, 4.0])
    state = jax.eval_shape(env.reset, jax.random.key(0))
    after, transition = jax.eval_shape(env.step, jax.random.key(0), state, jnp.zeros(1))
    assert transition.observation.dtype == transition.reward.dtype == jnp.float64
    assert jax.tree.structure(state) == jax.tree.structure(after)
    for was, now in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
        assert (was.dtype, was.shape) == (now.dtype, now.shape)
        assert "64" not in now.dtype.name and not was.weak_type and not now.weak_type


def test_what_cannot_be_learned_on_is_refused_in_a_line(spring, monkeypatch):
    monkeypatch.setitem(brax_envs._envs, "mapping", lambda backend: Spring(backend, as_mapping=True))
    for settings, message in (
        ({"name": "sprig"}, 'name: got "sprig"; Brax has no such environment; it has: .*, spring, '),
        ({"name": "spring", "low": [1.0, 2.0, 3.0]}, "low: got 3 numbers; spring has 2 observations"),
        ({"name": "spring", "low": 1.0, "high": [2.0, 1.0]}, "low: allowed: < high"),
        ({"name": "mapping"}, 'got "mapping"; its observations are not a vector'),
    ):
        with one_line(ConfigError, message):
            build(envs.Brax(**settings), "float32")


def test_importing_it_prints_nothing():
    found = subprocess.run(
        [sys.executable, "-c", "import bojax.envs.brax"], capture_output=True, text=True, check=True
    )
    assert found.stdout == found.stderr == ""


def test_ours_rolls_under_the_wrappers_of_brax_training():
    """Episodes of 20 steps, in 3 lanes; each begins anew, and the reward is that of our own steps."""
    own = build(envs.SinglePendulum(reward="classic", classic_ends_at_goal=False), "float32")
    with plain_jax():
        env = training.wrap(BojaxEnv(own), episode_length=20)
        assert (env.observation_size, env.action_size, env.backend) == (3, 1, "bojax")
        state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), 3))
        step, dones = jax.jit(env.step), []
        reward = jax.jit(jax.vmap(lambda s, a: own.step(jax.random.key(0), s, 2.0 * a)[1].reward))
        for i in range(41):
            before, _ = state.pipeline_state
            action = jnp.full((3, 1), 0.5 * (-1) ** i)
            state = step(state, action)
            dones.append(np.asarray(state.done))
            np.testing.assert_allclose(state.reward, reward(before, action), rtol=1e-5)
        np.testing.assert_array_equal(np.flatnonzero(np.all(dones, axis=1)) + 1, [20, 40])
        assert np.sum(dones) == 6
        assert np.all(state.info["truncation"] == 0) and state.metrics["success"].shape == (3,)


def test_brax_sees_our_goals():
    own = build(envs.SinglePendulum(), "float32")
    env = BojaxEnv(own)
    state = jax.jit(env.reset)(jax.random.key(0))
    state = state.replace(pipeline_state=(jnp.asarray([0.01, 0.0], jnp.float32), state.reward))
    state = jax.jit(env.step)(state, jnp.zeros(1, jnp.float32))
    assert (state.reward, state.done, state.metrics["success"]) == (1.0, 1.0, 1.0)


def test_a_success_counts_once_in_each_episode():
    """Upright at the start of each episode of 5 steps, which does not end at the goal."""
    own = build(envs.SinglePendulum(reward="classic", classic_ends_at_goal=False), "float32")
    with plain_jax():
        env = training.wrap(BojaxEnv(own), episode_length=5)
        state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), 1))
        upright = jnp.zeros((1, 2), jnp.float32), jnp.zeros(1, jnp.float32)
        state = state.replace(pipeline_state=upright, info={**state.info, "first_pipeline_state": upright})
        step, found = jax.jit(env.step), []
        for _ in range(10):
            state = step(state, jnp.zeros((1, 1)))
            found.append(float(state.metrics["success"][0]))
    assert found == [1, 0, 0, 0, 0, 1, 0, 0, 0, 0]


def test_a_typed_key_begins_the_same_episode_as_a_raw_one():
    reset = jax.jit(BojaxEnv(build(envs.SinglePendulum(), "float32")).reset)
    typed, raw = reset(jax.random.key(3)), reset(jax.random.key_data(jax.random.key(3)))
    np.testing.assert_array_equal(typed.obs, raw.obs)
    assert np.any(np.asarray(raw.obs) != np.asarray(reset(jax.random.key(4)).obs))


def test_brax_takes_vectors_only():
    with pytest.raises(ValueError, match="Chain: Brax takes vectors as observations and actions"):
        BojaxEnv(build(envs.Chain()))


def test_the_class_is_what_the_config_names():
    assert isinstance(build(envs.Brax(name="fast"), "float32"), BraxEnv)
