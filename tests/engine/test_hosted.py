"""Environments that step on the host: the same learning run, driven from outside."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from bojax.config.points import Point, Sweep
from bojax.config.settings import EngineConfig, Record
from bojax.engine.batch import Functions, Programs
from bojax.engine.build import build
from bojax.engine.groups import static_groups
from bojax.engine.hosted import Hosted
from bojax.envs.settings import Gymnasium
from bojax.experiments.settings import Learning
from bojax.learning.settings import EpsilonGreedy
from bojax.results.store import read_manifest, read_table
from tests.engine.drive import ROOT, run_sweep
from tests.tiers import by_tier

GRID = Gymnasium(id="tests.engine.test_hosted:Corridor-v0", success="terminated", max_steps=12)

CRASH = "CORRIDOR_CRASHES"
"""Environment variable that makes the corridor end its process, as broken native code does."""

gymnasium = pytest.importorskip("gymnasium")


class Corridor(gymnasium.Env):
    """Five places in a row; the last one ends the episode. Random draws follow from the seed of `reset`."""

    def __init__(self, breaks: str = ""):
        self.observation_space = gymnasium.spaces.Discrete(5)
        self.action_space = gymnasium.spaces.Discrete(2)
        self._breaks = breaks

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._place = int(self.np_random.integers(2))
        return self._place, {}

    def step(self, action):
        slips = self.np_random.uniform() < 0.1
        self._place = max(0, self._place + (1 if (action == 1) != slips else -1))
        is_end = self._place == 4
        reward = float("nan") if self._breaks == "reward" and self._place == 3 else float(is_end)
        if self._breaks == "step" and self._place == 3:
            raise RuntimeError("the motor broke")
        if self._breaks == "exit" and self._place == 3:
            sys.exit(0)
        if self._breaks == "quit" and self._place == 3:
            raise KeyboardInterrupt
        if os.environ.get(CRASH) and self._place == 3 and self.np_random.uniform() < 0.3:
            os.kill(os.getpid(), signal.SIGSEGV)
        return self._place, reward, is_end, False, {"is_success": is_end}


gymnasium.register("Corridor-v0", Corridor, max_episode_steps=50)


def sweep(runs: int = 6, **settings) -> Sweep:
    changes = {name: settings.pop(name) for name in ("kwargs", "success") if name in settings}
    learner = EpsilonGreedy(epsilon=0.3, block=4)
    env = GRID.model_copy(update=changes)
    config = Learning(env=env, learner=learner, episodes=5, tests=2, **settings)
    return Sweep(
        name="corridor",
        title="corridor",
        points=(Point(0, config.label, config.label, {}, config),),
        runs=runs,
        seed=3,
        record=Record(),
        engine=EngineConfig(device="cpu", lanes_per_device=3),
        report={},
        claims=(),
        base={},
        source=Path("here"),
    )


def tables_in(folder) -> dict[str, bytes]:
    return {name: (folder / f"{name}.parquet").read_bytes() for name in ("runs", "episodes", "steps")}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The results of the sweep, undisturbed."""
    out = tmp_path_factory.mktemp("finished") / "a"
    assert run_sweep(sweep(), out, False, ["bojax"]) == 0
    return out


def test_runs_to_the_end_and_reports_every_episode(finished):
    runs, episodes, steps = (
        read_table(finished / f"{name}.parquet") for name in ("runs", "episodes", "steps")
    )
    assert runs.num_rows == 6
    phases = episodes["phase"].to_pylist()
    assert (phases.count("train"), phases.count("test")) == (30, 60)
    lengths = np.asarray(episodes["length"])
    assert lengths.min() >= 3 and lengths.max() <= 12
    ended = np.asarray(episodes["terminated"])
    np.testing.assert_array_equal(np.asarray(episodes["return"]) == 1.0, ended)
    np.testing.assert_array_equal(np.asarray(episodes["truncated"]), ~ended)
    np.testing.assert_array_equal(np.asarray(episodes["success"]), ended)
    is_training = np.asarray([phase == "train" for phase in phases])
    assert steps.num_rows == lengths[is_training].sum()
    assert len(set(runs["steps"].to_pylist())) > 1  # lanes differ
    kappa = np.asarray(episodes["kappa"])
    np.testing.assert_allclose(kappa[is_training], 0.3, atol=1e-6)
    np.testing.assert_array_equal(kappa[~is_training], 0.0)


def test_a_sweep_repeats_and_success_by_info_is_success_by_the_terminal_state(finished, tmp_path):
    assert run_sweep(sweep(success="info"), tmp_path / "b", False, ["bojax"]) == 0
    assert tables_in(tmp_path / "b") == tables_in(finished)


def test_a_number_that_is_none_ends_the_run_alone(tmp_path):
    assert run_sweep(sweep(kwargs={"breaks": "reward"}), tmp_path / "a", False, ["bojax"]) == 0
    runs = read_table(tmp_path / "a" / "runs.parquet")
    broken = np.isnan(np.asarray(runs["last_return"]))
    assert broken.any()
    np.testing.assert_array_equal(np.asarray(runs["nans"]) > 0, broken)


@pytest.mark.parametrize(
    ("breaks", "error"),
    [
        ("step", "RuntimeError: the motor broke"),
        ("exit", "SystemExit: 0"),
        ("quit", "KeyboardInterrupt"),
    ],
)
def test_an_environment_that_raises_or_exits_fails_its_chunk_in_one_line(tmp_path, capsys, breaks, error):
    assert run_sweep(sweep(kwargs={"breaks": breaks}), tmp_path / "a", False, ["bojax"]) == 1
    assert f"chunks failed: {error}" in capsys.readouterr().err
    assert all(error in chunk["error"] for chunk in read_manifest(tmp_path / "a")["chunks"])


@pytest.mark.bits
def test_a_sweep_goes_on_after_an_environment_crashed(finished, tmp_path):
    program = (
        "import tests.strict, sys; from pathlib import Path; from tests.engine.test_hosted import *; "
        "sys.exit(run_sweep(sweep(), Path(sys.argv[1]), False, ['bojax']))"
    )
    crashed = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "b")],
        cwd=ROOT,
        env={**os.environ, CRASH: "1"},
        check=False,
    )
    assert crashed.returncode == -signal.SIGSEGV
    assert not (tmp_path / "b" / "runs.parquet").exists()
    assert run_sweep(sweep(), tmp_path / "b", True, ["bojax"]) == 0
    assert tables_in(tmp_path / "b") == tables_in(finished)


@pytest.mark.bits
@pytest.mark.parametrize("tests_learn", by_tier(["no", "exploiting", "exploring"], normal=["exploring"]))
def test_is_what_the_compiled_run_does(tests_learn):
    """One of our environments, stepped on the host, ends in the tables of its compiled run."""
    from bojax.envs.settings import Chain

    compiled_run = build(
        Learning(
            env=Chain(length=5),
            learner=EpsilonGreedy(epsilon=0.3, block=4),
            episodes=3,
            tests=2,
            tests_learn=tests_learn,
        ),
        "float32",
    )
    given = Functions(static_groups([compiled_run])[0]), jax.devices("cpu")[0], 3, 0
    programs = [kind(*given, recorded=0) for kind in (Programs, OurHosted)]
    ends = []
    for program in programs:
        lanes = program.place(np.zeros(3, np.int32), np.arange(3, dtype=np.int32))
        carry = program.init(lanes)
        for _ in range(3):
            carry, _, _ = program.advance(carry, lanes)
        ends.append(program.summary(carry, lanes))
    for name in ends[0]:
        np.testing.assert_array_equal(ends[0][name], ends[1][name])
    assert np.unique(ends[0]["steps"]).size > 1


class OurHosted(Hosted):
    """Steps one of our environments with the keys of the compiled run, in place of a vector environment."""

    def _open(self, run):
        self._num_tests, self._tests_learn, self._block = run.tests, run.learns_in_tests, run.learner.block
        self._dtype = run.learner.exploration_weight.dtype
        self._our_reset = self._program(our_reset)
        self._our_step = self._program(our_step)

    def _reset(self, phase, lanes, carry, number):
        self._call = (lanes, carry, number)
        self._count = 0
        self._state, observation = self._our_reset(lanes, carry, number)
        return observation

    def _step(self, action):
        self._state, time_step = self._our_step(*self._call, self._state, action, self._all(self._count))
        self._count += 1
        return time_step


def our_reset(run, carry, number):
    return run.reset(carry, run.test(carry, number))  # number 0 has the key of the training episode


def our_step(run, carry, number, state, action, step):
    keys = jax.random.wrap_key_data(run.test(carry, number).step_keys(step[None])[0])
    return run.env.step(keys[1], state, action)
