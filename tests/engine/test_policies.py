"""Policies of what runs have learned: those of the engine's episodes, in loops outside of it."""

import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bojax
from bojax.cli.main import main
from bojax.engine.training import train
from bojax.envs.gymnasium import GymnasiumEnv
from bojax.envs.settings import MountainCar
from bojax.learning.settings import EMUQ, RandomFourierFeatures
from tests.refusals import one_line

CHAIN = {"kind": "chain", "max_steps": 12}


def rollout(env, policy):
    """Observations and actions of an episode in Gymnasium's loop, and its return."""
    observation, _ = env.reset(seed=0)
    seen, total, is_over = [], 0.0, False
    while not is_over:
        action = policy(observation)
        seen.append((observation, int(action)))
        observation, reward, terminated, truncated, _ = env.step(action)
        total, is_over = total + reward, terminated or truncated
    return seen, total


def test_a_loop_in_gymnasium_has_the_returns_of_the_engines_tests():
    trained = train(CHAIN, "additive", episodes=30, runs=4, tests=1)
    rows = trained.episodes.to_pylist()
    for run in range(4):
        (expected,) = (
            row["return"] for row in rows if (row["run"], row["episode"], row["phase"]) == (run, 30, "test")
        )
        policy = trained.policy(run)
        assert rollout(GymnasiumEnv(policy.env), policy)[1] == pytest.approx(expected)


def test_the_policy_of_a_box_takes_plain_numbers_and_expects_its_learners_value():
    learner = EMUQ(features=RandomFourierFeatures(num_features=16), refit="sweeps")
    trained = train(MountainCar(max_steps=20), learner, episodes=2)
    policy, again = trained.policy(), trained.policy()
    actions = [policy([-0.5, 0.0]) for _ in range(3)]
    assert all(action.shape == (1,) and abs(action[0]) <= 1.0 for action in actions)
    assert np.array_equal(actions[0], again(np.array([-0.5, 0.0], np.float64)))
    assert not np.array_equal(actions[0], actions[1])  # the candidates are drawn anew
    state = jax.tree.map(lambda leaf: leaf[0], trained.learned)
    assert len(state.memory.rewards) == 1
    action, expected = again.act([-0.5, 0.01])
    seen = jnp.asarray([-0.5, 0.01], jnp.float32)
    value, _ = trained.experiment.learner.values(state, seen, jnp.asarray(action))
    assert expected == pytest.approx(float(value), abs=1e-5)
    with pytest.raises(ValueError, match=r"the observation is \[nan, 0.01\]; allowed: finite numbers"):
        policy([float("nan"), 0.01])


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("policies") / "results"
    words = "chain episodes=20 stop=never record.learners=true --runs 2".split()
    assert main(["run", *words, "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def evaluation(saved):
    folder = saved.parent / "evaluation"
    words = ["saved_run=1", "episodes=2", "--runs", "1", "--out", str(folder)]
    assert main(["run", str(saved / "learners" / "0"), *words]) == 0
    return bojax.load(folder)


def test_a_saved_policy_takes_the_actions_of_an_evaluation_by_the_engine(saved, evaluation):
    policy = bojax.load(saved).policy(run=1)
    rows = evaluation.steps.to_pylist()
    assert len(rows) > 4
    for row in rows:
        assert int(policy(int(row["observation_0"]))) == row["action_0"]


def test_actions_repeat_with_the_seed_and_jax_keeps_its_precision(saved):
    before = jax.config.jax_enable_x64
    results = bojax.load(saved)
    first, second = (results.policy("exploration-values", seed=3) for _ in range(2))
    for state in range(5):
        assert first(state) == second(state)
    assert jax.config.jax_enable_x64 == before
    assert isinstance(first(0), np.integer)  # a key of a dictionary, an index of a list


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"point": "emu"}, "no point emu; allowed: exploration-values"),
        ({"point": 3}, "no point 3; allowed: exploration-values"),
        ({"run": 7}, "holds no learner of run 7; allowed: 0, 1"),
        ({"run": -1}, "saved_run: got -1; allowed: >= 0"),
    ],
)
def test_a_policy_that_is_not_there_is_one_line(saved, arguments, message):
    with one_line(bojax.BojaxError, message):
        bojax.load(saved).policy(**arguments)


def test_results_without_learners_say_how_to_save_them(evaluation):
    with pytest.raises(
        bojax.BojaxError, match="no learner was saved; allowed: results of record.learners=true"
    ):
        evaluation.policy()


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        (0.5, "dtype float64; allowed: integers"),
        (99, "99; allowed: an integer from 0 to"),
        ([0, 1], r"\[0 1\]"),
    ],
)
def test_an_observation_outside_its_space_is_refused(saved, observation, message):
    with pytest.raises(ValueError, match=message):
        bojax.load(saved).policy()(observation)


def test_an_experiment_without_saved_learners_has_no_policy(saved, tmp_path):
    folder = shutil.copytree(saved, tmp_path / "copy")
    path = folder / "learners" / "0" / "experiment.yaml"
    path.write_text(path.read_text().replace("saved: learner\n", ""))
    with one_line(bojax.BojaxError, "experiment.yaml: saved: got null; allowed: the folder"):
        bojax.load(folder).policy()
