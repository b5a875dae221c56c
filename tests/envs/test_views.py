"""Our environments with the interfaces of gymnax and of Gymnasium's vectors, against our own single steps."""

import functools

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from bojax.engine.build import build
from bojax.envs import settings as envs
from bojax.envs.base import Env, TimeStep
from bojax.envs.gymnasium import GymnasiumEnv
from bojax.envs.gymnasium_vector import GymnasiumVectorEnv
from bojax.envs.gymnax import GymnaxEnv
from bojax.envs.spaces import Box
from tests.refusals import assert_refused, without_annotation_checks

LIMIT = 5


@functools.cache
def pendulum():
    return build(envs.SinglePendulum(max_steps=LIMIT, goal_angle=1.0, reward="classic"), "float32")


@functools.cache
def chain():
    return build(envs.Chain(length=3, max_length=3, max_steps=LIMIT), "float32")


class Hidden(Env):
    """Episodes that begin in a state which all episodes of a run share."""

    start: Float[Array, ""] | None
    max_steps: int = eqx.field(static=True, default=LIMIT)

    @property
    def observation_space(self):
        return Box(jnp.zeros(1), jnp.ones(1))

    @property
    def action_space(self):
        return Box(jnp.zeros(1), jnp.ones(1))

    def of_run(self, key):
        return Hidden(jax.random.uniform(key)) if self.start is None else self

    def reset(self, key):
        return jax.random.uniform(key) if self.start is None else self.start

    def observe(self, state):
        return state[None]

    def step(self, key, state, action):
        done = jnp.ones((), bool)
        return state, TimeStep(self.observe(state), state, done, ~done, done)


@pytest.mark.parametrize("key", [None, 1])
def test_all_episodes_of_a_view_share_what_the_episodes_of_a_run_share(key):
    env = Hidden(None) if key is None else Hidden(None).of_run(jax.random.key(key))
    start = np.float32(jax.random.uniform(jax.random.key(key or 0)))
    single, vector, view = GymnasiumEnv(env), GymnasiumVectorEnv(env, 2), GymnaxEnv(env)
    seen = [single.reset(seed=1)[0], single.reset()[0], *vector.reset(seed=2)[0]]
    seen += [*vector.step(np.zeros((2, 1), np.float32))[0], view.reset(jax.random.key(3))[0]]
    np.testing.assert_array_equal(np.stack(seen).astype(np.float32), start)


class Hosted(Hidden):
    """The same, as if it were stepped on the host."""

    is_hosted = True


@pytest.mark.parametrize("view", [GymnasiumEnv, functools.partial(GymnasiumVectorEnv, num_envs=2), GymnaxEnv])
def test_what_is_no_compiled_environment_is_refused(view):
    named = "^env: got 'mountain-car'; allowed: an environment, such as bojax.part"
    hosted = "^Hosted: is stepped on the host; allowed: a compiled environment$"
    with without_annotation_checks():
        assert_refused([(lambda: view("mountain-car"), named), (lambda: view(Hosted(None)), hosted)])


def expected(env, keys, actions):
    """Steps of one lane: `keys[0]` begins the first episode, `keys[t]` is the key of step t."""
    reset, step, observe = (eqx.filter_jit(function) for function in (env.reset, env.step, env.observe))
    state, rows, time = reset(keys[0]), [], 0
    for key, action in zip(keys[1:], actions, strict=True):
        key_step, key_reset = jax.random.split(key)
        state, result = step(key_step, state, action)
        time += 1
        terminated = bool(result.terminated)
        truncated = bool(result.truncated) or (time == LIMIT and not terminated)
        last = result.observation
        if terminated or truncated:
            state, time = reset(key_reset), 0
        row = observe(state), result.reward, terminated, truncated, bool(result.success), last
        rows.append([np.asarray(value) for value in row])
    return [np.stack(column) for column in zip(*rows, strict=True)]


def random_actions(env, num_lanes, num_steps):
    space, key = GymnaxEnv(env).action_space(), jax.random.key(8)
    keys = jax.random.split(key, (num_lanes, num_steps))
    return jax.vmap(jax.vmap(space.sample))(keys)


@pytest.mark.parametrize("make", [pendulum, chain])
def test_a_scan_of_the_view_of_gymnax_takes_our_steps_and_resets(make):
    env, view = make(), GymnaxEnv(make())
    actions = random_actions(env, 1, 3 * LIMIT)[0]
    keys = jax.random.split(jax.random.key(3), 3 * LIMIT + 1)

    @jax.jit
    def roll(params, keys, actions):
        _, state = view.reset(keys[0], params)

        def step(state, given):
            key, action = given
            observation, state, reward, done, info = view.step(key, state, action, params)
            return state, (observation, reward, done, info)

        return jax.lax.scan(step, state, (keys[1:], actions))[1]

    observations, rewards, done, info = roll(view.default_params, jax.random.clone(keys), actions)
    seen, paid, terminated, truncated, success, last = expected(env, keys, actions)
    assert truncated.any() and 0 < np.sum(done) < len(done)
    np.testing.assert_allclose(observations, seen, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(rewards, paid, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(done, terminated | truncated)
    np.testing.assert_array_equal(info["discount"], 1.0 - terminated)
    np.testing.assert_array_equal(info["success"], success)
    np.testing.assert_allclose(info["final_observation"], last, rtol=1e-5, atol=1e-6)


def test_spaces_of_the_view():
    box, discrete = GymnaxEnv(pendulum()).action_space(), GymnaxEnv(chain()).action_space()
    assert (box.shape, box.n, GymnaxEnv(pendulum()).num_actions) == ((1,), None, 1)
    assert (discrete.shape, discrete.n, GymnaxEnv(chain()).num_actions) == ((), 2, 2)
    assert box.contains(box.high) and not box.contains(box.high + 1.0)
    assert discrete.contains(jnp.asarray(1)) and not discrete.contains(jnp.asarray(2))


@pytest.mark.parametrize("make", [pendulum, chain])
def test_lanes_of_gymnasium_take_our_steps_and_are_reset_in_the_same_step(make):
    env, num_lanes, num_steps = make(), 3, 3 * LIMIT
    actions = np.asarray(random_actions(env, num_lanes, num_steps))
    vector = GymnasiumVectorEnv(env, num_lanes)
    first, _ = vector.reset(seed=4)
    space = vector.observation_space
    assert (first.shape, first.dtype) == (space.shape, space.dtype)
    steps = [vector.step(actions[:, t]) for t in range(num_steps)]
    for lane in range(num_lanes):
        key = jax.random.fold_in(jax.random.key(4), lane)
        keys = [jax.random.fold_in(key, t) for t in range(num_steps + 1)]
        seen, paid, terminated, truncated, success, last = expected(env, keys, actions[lane])
        of_lane = [[part[lane] for part in step[:4]] for step in steps]
        for column, wanted in zip(
            zip(*of_lane, strict=True), (seen, paid, terminated, truncated), strict=True
        ):
            np.testing.assert_allclose(np.stack(column), wanted, rtol=1e-5, atol=1e-6)
        for step, ended, hit, final in zip(steps, terminated | truncated, success, last, strict=True):
            assert step[4]["success"][lane] == hit
            assert step[4].get("_final_obs", np.zeros(num_lanes, bool))[lane] == ended
            if ended:
                np.testing.assert_allclose(step[4]["final_obs"][lane], final, rtol=1e-5, atol=1e-6)


def test_seeds_repeat_and_tell_lanes_apart():
    vector = GymnasiumVectorEnv(pendulum(), 2)
    one, two, listed = (vector.reset(seed=seed)[0] for seed in (1, 1, [5, 5]))
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(listed[0], listed[1])
    assert not np.array_equal(one[0], one[1])
    for seed in (1, [5, 6]):
        again = [[vector.reset(seed=each)[0] for each in (seed, None, None)] for _ in range(2)]
        np.testing.assert_array_equal(*again)
        assert not np.array_equal(again[0][1], again[0][2])
    wider = GymnasiumVectorEnv(pendulum(), 3).reset(seed=1)[0]
    np.testing.assert_array_equal(wider[:2], one)
    with pytest.raises(ValueError, match="seed: got 3 seeds; allowed: 2, one for each lane"):
        vector.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="options: got reset_mask; a lane is only reset at the end"):
        vector.reset(options={"reset_mask": np.array([True, False])})
    vector.reset(options={"reset_mask": np.array([True, True])})


def test_stepping_comes_after_a_reset():
    with pytest.raises(gymnasium.error.ResetNeeded):
        GymnasiumVectorEnv(pendulum(), 1).step(np.zeros((1, 1)))
    with pytest.raises(ValueError, match="num_envs: got 0; allowed: >= 1"):
        GymnasiumVectorEnv(pendulum(), 0)


def test_what_is_no_action_is_refused():
    """Otherwise it would be broadcast, or clipped to the last element."""
    views = {
        GymnasiumEnv(pendulum()): [(0.5, r"shape \(\); allowed: \(1,\)"), ([[0.5]], r"shape \(1, 1\)")],
        GymnasiumEnv(chain()): [
            (2, "got 2; allowed: integers from 0 to 1"),
            (-1, "got -1"),
            (np.nan, "got nan"),
            (jnp.asarray(0.5), "got 0.5"),
            ([1], r"shape \(1,\); allowed: \(\)"),
        ],
        GymnasiumVectorEnv(pendulum(), 3): [([0.5] * 3, r"shape \(3,\); allowed: \(3, 1\)")],
        GymnasiumVectorEnv(chain(), 3): [
            ([0, 1], r"shape \(2,\); allowed: \(3,\)"),
            ([0, 2, 1], r"got \[0, 2, 1\]"),
        ],
    }
    for view, wrong in views.items():
        view.reset(seed=0)
        for action, message in wrong:
            with pytest.raises(ValueError, match=f"^action: .*{message}"):
                view.step(action)
