"""Every environment: it is reset, observed and stepped."""

import jax
import numpy as np

from bojax.engine.build import build
from bojax.engine.training import train
from tests.parts import tiny
from tests.protocol.lanes import each_kind, of_one


def two_steps(env, key, _):
    """The start of an episode under random actions, and the bounds of its observations."""
    key_run, key_reset, key_steps = jax.random.split(key, 3)
    env = env.of_run(key_run)
    state = env.reset(key_reset)

    def step(state, key):
        key_step, key_action = jax.random.split(key)
        return env.step(key_step, state, env.action_space.sample(key_action))

    _, transitions = jax.lax.scan(step, state, jax.random.split(key_steps))
    return env.observe(state), transitions, env.observation_space


# Run in tests/envs, and compared there with what others wrote.
@each_kind("env", traced=["brax", "jaco", "lunar-lander"])
def test_an_environment_is_reset_and_stepped(kind, check):
    settings = tiny("env", kind)
    env = build(settings, "float32")
    if not env.is_hosted:
        check(env, of_one(two_steps))
        return
    # An environment on the host is stepped by the engine.
    training = train(settings.model_dump(), {"kind": "rff-q", "epsilon": 1.0}, episodes=2, runs=2)
    assert training.runs["episodes"].to_pylist() == [2, 2]
    assert np.isfinite(training.episodes["return"].to_numpy()).all()
    weights = np.asarray(training.learned.weights)
    assert np.isfinite(weights).all() and not np.array_equal(weights[0], weights[1])
