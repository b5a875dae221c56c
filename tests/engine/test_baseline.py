"""Random actions beside a learner: episodes as in a plain loop, the table, and when there is none."""

from dataclasses import replace
from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.config.sweep import load_config
from bojax.engine import baseline
from bojax.engine.build import build
from bojax.envs.settings import Chain, PointMaze
from bojax.experiments.learning import LearningRun
from bojax.experiments.learning_episodes import env_of_run, reset_key, shares_start
from bojax.experiments.random_baseline import random_episodes
from bojax.experiments.settings import Learning
from bojax.results.baseline import FILE
from bojax.results.store import read_table


@jax.jit
def choose_action(space, key):
    """A random action."""
    if hasattr(space, "num"):
        return jax.random.randint(key, (), 0, space.num, jnp.int32)
    return space.from_unit(jax.random.uniform(key, space.low.shape, space.low.dtype))


@eqx.filter_jit
def step(env, key, state, action):
    return env.step(key, state, action)


def plain_episode(env, seed, run, number, hold):
    """An episode in a Python loop: sum of rewards, length, success."""

    def key_of(*counters):
        """A new key each time, since a key is used once."""
        return reduce(jax.random.fold_in, counters, jax.random.key(seed))

    state = env_of_run(env, key_of(run)).reset(
        reset_key(key_of(run), jnp.asarray(number), 0, shares_start("per-episode"))
    )
    total, space, action = 0.0, env.action_space, None
    for time in range(env.max_steps):
        choose, move = jax.random.split(key_of(run, number, 1, time))
        if time % hold == 0:
            action = choose_action(space, choose)
        state, made = step(env, move, state, action)
        total += float(made.reward)
        if made.terminated:
            return total, time + 1, bool(made.success)
    return total, env.max_steps, False


NEAR = PointMaze(layout="open", max_steps=20, move=0.1, goal_radius=0.95, reward="classic")


@pytest.mark.parametrize("settings", [NEAR, Chain(length=3, max_steps=9)])
def test_episodes_are_those_of_a_plain_loop(settings):
    env = build(settings)
    lanes = [(run, number, hold) for run in (0, 1) for number in (1, 2) for hold in (1, 4)]
    run, number, hold = (jnp.asarray(x, jnp.int32) for x in zip(*lanes, strict=True))
    keys = jax.vmap(lambda run: jax.random.fold_in(jax.random.key(3), run))(run)
    found = random_episodes(env, "per-episode", keys, number, hold)
    expected = [plain_episode(env, 3, *lane) for lane in lanes]
    np.testing.assert_allclose(found.total, [each[0] for each in expected])
    np.testing.assert_array_equal(found.length, [each[1] for each in expected])
    np.testing.assert_array_equal(found.success, [each[2] for each in expected])
    assert len(np.unique(found.length)) > 2 and np.any(found.success)


def sweep_of(*overrides):
    return load_config("point-maze", ["env.layout=open", "episodes=12", *overrides])


def test_held_actions_find_a_goal_that_single_ones_do_not(tmp_path):
    baseline.write_baseline(sweep_of(), tmp_path)
    table = read_table(tmp_path / FILE).to_pydict()
    repeat, success = np.asarray(table["action_repeat"]), np.asarray(table["success"])
    assert len(repeat) == 2 * baseline.RUNS * 12 and set(repeat) == {1, 8}
    assert np.mean(success[repeat == 8]) > np.mean(success[repeat == 1]) + 0.05
    order = list(zip(table["action_repeat"], table["run"], table["episode"], strict=True))
    assert order == sorted(order) and set(table["episode"]) == set(range(1, 13))
    np.testing.assert_array_equal(table["return"], success)


def test_a_run_of_random_actions_begins_where_a_run_of_the_learner_does():
    config = sweep_of().points[0].config
    assert isinstance(config, Learning)
    run = build(config, "float32")
    assert isinstance(run, LearningRun)
    key = jax.random.fold_in(jax.random.key(0), 2)
    carry = eqx.filter_jit(run.init)(key)
    state = jax.jit(lambda carry: run.reset(carry, run.training(carry))[0])(carry)
    first = reset_key(key, jnp.asarray(1, jnp.int32), 0, shares_start(config.starts))
    own = jax.jit(lambda key, first: env_of_run(run.env, key).reset(first))(key, first)
    np.testing.assert_array_equal(state, own)


@pytest.mark.parametrize(
    "change", ["learner=random", "env=reacher", "episodes=100000", "env={kind: brax, name: reacher}"]
)
def test_slow_and_random_runs_have_no_baseline(change, tmp_path, capsys):
    baseline.write_baseline(load_config("point-maze", [change]), tmp_path)
    assert not (tmp_path / FILE).exists() and capsys.readouterr().err == ""


def test_a_baseline_that_takes_long_or_fails_is_a_note(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(baseline, "MOST_SECONDS", 0.0)
    baseline.write_baseline(sweep_of(), tmp_path)
    assert capsys.readouterr().err == "note: no baseline of random actions: it takes over 0 s\n"

    def broken(*_):
        raise RuntimeError("no\nluck")

    monkeypatch.setattr(baseline, "random_episodes", broken)
    baseline.write_baseline(sweep_of(), tmp_path)
    assert capsys.readouterr().err == "note: no baseline of random actions: RuntimeError: no luck\n"
    assert not (tmp_path / FILE).exists()


def test_a_baseline_that_is_there_and_a_planner_are_left_alone(tmp_path):
    (tmp_path / FILE).write_text("kept")
    baseline.write_baseline(sweep_of(), tmp_path)
    assert (tmp_path / FILE).read_text() == "kept"
    (tmp_path / FILE).unlink()
    baseline.write_baseline(load_config("parking"), tmp_path)
    sweep = sweep_of()
    saved = sweep.points[0].config.model_copy(update={"saved": "folder"})
    point = replace(sweep.points[0], config=saved)
    baseline.write_baseline(replace(sweep, points=(point,)), tmp_path)
    assert not list(tmp_path.iterdir())
