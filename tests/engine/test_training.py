"""Training from Python gives the results of a sweep, and a policy that exploits."""

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pytest

from bojax.config.errors import ConfigError
from bojax.config.sweep import load_config
from bojax.engine.build import build
from bojax.engine.training import train
from bojax.envs.settings import Chain
from bojax.learning.settings import AdditiveRewards, Budget
from bojax.results.store import read_table
from bojax.results.tables import sort_rows
from tests.engine.drive import run_sweep
from tests.learning.probes import Bandit
from tests.refusals import one_line, without_annotation_checks

CHAIN = {"kind": "chain", "length": 4, "max_length": 4, "max_steps": 40}
HOW = {"episodes": 3, "seed": 5, "tests": 1, "dtype": "float64"}


@pytest.fixture(scope="module")
def trained():
    return train(CHAIN, "additive", runs=3, schedule={"kind": "budget", "episodes": 2}, **HOW)


def test_it_is_the_run_of_a_config(trained, tmp_path):
    config = tmp_path / "config.yaml"
    config.write_text(
        "{experiment: learning, env: {kind: chain, length: 4, max_length: 4, max_steps: 40}, "
        "learner: additive, runs: 3, seed: 5, episodes: 3, tests: 1, dtype: float64, "
        "schedule: {kind: budget, episodes: 2}}"
    )
    assert run_sweep(load_config(str(config)), tmp_path / "out", False, ["bojax"]) == 0
    for name, table in (("runs", trained.runs), ("episodes", trained.episodes)):
        written = read_table(tmp_path / "out" / f"{name}.parquet", table.column_names)
        assert table.num_rows == {"runs": 3, "episodes": 18}[name]
        assert written.cast(table.schema).equals(table)


def test_parts_are_modules_or_settings_and_a_run_does_not_depend_on_the_others(trained):
    env = build(Chain(length=4, max_length=4, max_steps=40))
    alone = train(env, build(AdditiveRewards()), schedule=Budget(episodes=2), **HOW)
    assert alone.episodes.num_rows == 6
    assert alone.episodes.equals(trained.episodes.slice(0, 6))
    np.testing.assert_allclose(alone.learned.columns[0], trained.learned.columns[0], atol=1e-12)


@pytest.mark.parametrize(
    ("flag", "value"), [("jax_default_prng_impl", "rbg"), ("jax_threefry_partitionable", False)]
)
def test_flags_of_the_caller_change_no_random_number(trained, flag, value):
    given = getattr(jax.config, flag)
    jax.config.update(flag, value)
    try:
        again = train(CHAIN, "additive", runs=3, schedule=Budget(episodes=2), **HOW)
        policy = again.policy(seed=3)
        actions = [policy(0) for _ in range(20)]
        assert getattr(jax.config, flag) == value
    finally:
        jax.config.update(flag, given)
    assert again.runs.equals(trained.runs)
    assert again.episodes.equals(trained.episodes)
    policy = trained.policy(seed=3)
    assert actions == [policy(0) for _ in range(20)]


def test_a_callback_gets_the_rows_of_each_episode(trained):
    parts = []
    again = train(CHAIN, "additive", runs=3, schedule=Budget(episodes=2), callback=parts.append, **HOW)
    assert [set(part["episode"].to_pylist()) for part in parts] == [{1}, {2}, {3}]
    assert [part["run"].to_pylist() for part in parts] == [[0, 0, 1, 1, 2, 2]] * 3
    assert sort_rows(pa.concat_tables(parts)).equals(again.episodes)
    assert again.episodes.equals(trained.episodes)


def test_a_callback_gets_one_episode_at_a_time_of_runs_that_do_not_wait_for_each_other():
    parts = []
    train(CHAIN, "dora", runs=2, episodes=5, callback=parts.append)
    assert [part["episode"].to_pylist() for part in parts] == [[number] * 2 for number in range(1, 6)]


def test_an_exception_in_the_callback_ends_the_training():
    calls = []

    def fail(rows):
        calls.append(rows)
        raise StopIteration("enough")

    with pytest.raises(StopIteration, match="enough"):
        train(CHAIN, "additive", runs=3, schedule=Budget(episodes=2), callback=fail, **HOW)
    assert len(calls) == 1


def test_a_learner_may_have_no_state():
    policy = train(CHAIN, "random", runs=2, episodes=2).policy(run=1)
    assert {int(policy(0)) for _ in range(20)} == {0, 1}


def test_it_stops_at_the_first_success():
    trained = train(CHAIN, "epsilon-greedy", episodes=50, runs=4, stop="first-success")
    assert trained.runs["episodes"].equals(trained.runs["episodes_to_goal"])
    assert trained.runs["success"].to_pylist() == [True] * 4


def test_the_policy_exploits():
    bandit = Bandit(jnp.asarray([-1.0, 1.0], jnp.float32))
    trained = train(bandit, {"kind": "epsilon-greedy", "epsilon": 1.0}, episodes=20, runs=2)
    for run in range(2):
        policy = trained.policy(run)
        assert [int(policy(0)) for _ in range(10)] == [1] * 10
    for run, message in [(2, "run: got 2; allowed: < 2"), (-1, "run: got -1")]:
        with one_line(ValueError, message):
            trained.policy(run)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"episodes": 0}, ValueError, "episodes: got 0"),
        ({"runs": 0}, ValueError, "runs: got 0"),
        ({"runs": 1.5}, ValueError, "runs: got 1.5; allowed: an integer >= 1"),
        ({"seed": -1}, ValueError, "seed: got -1; allowed: an integer >= 0"),
        ({"seed": 2**32}, ValueError, r"seed: got 4294967296; allowed: < 2\^32"),
        ({"seed": "a"}, ValueError, 'seed: got "a"; allowed: an integer >= 0'),
        ({"dtype": "float16"}, ConfigError, 'dtype: got "float16"'),
        ({"callback": 3}, ValueError, "callback: got 3; allowed: a function"),
        ({"env": "mountain"}, ConfigError, "env: .*mountain"),
        ({"learner": {"kind": "additive", "zeta": 1}}, ConfigError, "learner.zeta: unknown key"),
        ({"learner": "additive", "env": "mountain-car"}, ValueError, "Discrete"),
        ({"env": "my_env:Puck"}, ConfigError, "env"),
    ],
)
def test_mistakes_are_refused(given, error, message):
    with without_annotation_checks(), one_line(error, message):
        train(**{"env": "chain", "learner": "additive", "episodes": 1} | given)
