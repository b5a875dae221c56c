"""Runs from Python: in a process of their own, or in this one, whose flags of JAX stay as they are."""

import os
import signal
import sys
import threading
import time
from pathlib import Path

import jax
import numpy as np
import pytest

import bojax
from bojax.api.command import Output, run_here
from bojax.engine import signals
from bojax.engine.devices import _FLAGS
from bojax.results.folder import is_unfinished
from bojax.results.store import read_manifest
from tests.learning.probes import Bandit
from tests.refusals import assert_refused, one_line

CHAIN = {"kind": "chain", "length": 4, "max_length": 4, "max_steps": 40}
CONFIG = {"experiment": "learning", "env": CHAIN, "learner": "additive", "episodes": 3}


class Broken(Bandit):
    """A bandit that cannot be traced."""

    def outcome(self, state, action, branch):
        raise ZeroDivisionError("no such arm")


@pytest.fixture(autouse=True)
def here(here, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as in a notebook
    return here


def state():
    """What a call might change in the caller's process."""
    flags = {flag: getattr(jax.config, flag) for flag in _FLAGS}
    environment = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
    return flags, list(sys.path), environment, signal.getsignal(signal.SIGINT), sys.stderr


@pytest.fixture
def caller(usual_jax):
    """A process in which JAX has started with its defaults; afterwards, everything is as it was."""
    assert jax.devices() and not jax.config.jax_enable_x64
    before = state()
    yield
    assert state() == before


def test_a_mapping_runs_in_a_process_of_its_own(caller, capfd):
    results = bojax.run(CONFIG, runs=2, seed=3, **{"episodes": 4, "dtype": "float64"})
    assert results.folder.parent == Path.cwd() / "results" / "config"
    assert results.runs["run"].to_pylist() == [0, 1]
    assert results.episodes["episode"].to_pylist() == [1, 2, 3, 4] * 2
    assert results.episodes.schema.field("return").type == "double"
    command = "bojax run - episodes=4 'dtype=\"float64\"' --runs 2 --seed 3"
    assert results.manifest["command"].startswith(command)
    assert results.settings["env"]["length"] == 4 and results.settings["episodes"] == 4
    assert results.report.is_file()
    shown = capfd.readouterr()
    assert "compiled additive" in shown.err and '"title"' not in shown.err and shown.out == ""
    assert "report: " not in shown.err


def test_a_class_runs_in_this_process(caller, capfd):
    results = bojax.run(ARMS, runs=3, out="arms", resume=True, episodes=2)
    assert set(results.episodes["return"].to_pylist()) <= {-1.0, 2.0}
    assert results.runs.num_rows == 3
    assert results.manifest["points"][0]["config"]["env"]["kind"] == "tests.learning.probes:Bandit"
    assert "note: nothing to resume; starting anew: arms\n" in capfd.readouterr().err


ARMS = {"experiment": "learning", "env": {"kind": Bandit, "rewards": (-1.0, 2.0)}, "learner": "additive"}
RANGES = {"learner.learning_rate": (0.05, 1, "log"), "learner.discount": (0.5, np.float64(1.0))}


def test_a_search_is_the_command_of_the_same_name(caller, monkeypatch):
    asked = []
    monkeypatch.setattr("bojax.cli.tuning.search", lambda task, *_: asked.append(task) or 1)
    with pytest.raises(bojax.BojaxError):
        bojax.tune(ARMS, RANGES, metric="steps_to_goal", minimise=True, budget=8, batch=2, runs=2, confirm=3)
    (task,) = asked
    assert (task.column, task.is_least, task.batch, task.rounds) == ("steps_to_goal", True, 2, 2)
    assert (task.config.runs, task.confirm) == (2, 3)
    bounds = [(each.key, each.low, each.high, each.is_log) for each in task.ranges]
    assert bounds == [("learner.learning_rate", 0.05, 1.0, True), ("learner.discount", 0.5, 1.0, False)]


def test_commands_in_this_process_run_one_after_another(caller, monkeypatch):
    running, seen = [], []

    def dispatch(words):
        running.append(words)
        jax.config.update("jax_enable_x64", True)
        time.sleep(0.05)
        seen.append(len(running))
        running.pop()
        return 0

    monkeypatch.setattr("bojax.cli.main.dispatch", dispatch)
    threads = [threading.Thread(target=run_here, args=(["run"], None)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen == [1, 1, 1]


@pytest.mark.slow
def test_a_search_returns_what_it_has_found(caller, capfd):
    found = bojax.tune(ARMS, RANGES, budget=8, batch=2, runs=2, confirm=3, episodes=2)
    assert found.folder.parent == Path.cwd() / "results" / "config-tune" and found.report.is_file()
    assert found.points.num_rows == 4 and found.confirmed is not None
    assert "round 2 of 2" in capfd.readouterr().out


DISCOUNT = "learner.discount"
MISTAKES = [
    (lambda: bojax.run("mountain-cra"), 'mountain-cra: no such file.*did you mean "mountain-car"'),
    (lambda: bojax.sweep("fig-4.7"), "fig-4.7: no such file"),
    (lambda: bojax.run(CONFIG, episodes=0), "^episodes: got 0; allowed: >= 1$"),
    (lambda: bojax.run(CONFIG, runs=0), "^runs: got 0; allowed: >= 1$"),
    (lambda: bojax.run(CONFIG, runs=2.5), "^runs: got 2.5; allowed: an integer$"),
    (lambda: bojax.run(CONFIG, runs=np.int64(0)), "^runs: got 0; allowed: >= 1$"),
    (lambda: bojax.run(CONFIG, seed=float("nan")), "^seed: got nan; allowed: a finite number$"),
    (lambda: bojax.run(None), "^run: got null, of type NoneType; allowed: a name, a path or a mapping$"),
    (lambda: bojax.sweep(b"parking"), "^sweep: got b'parking', of type bytes; allowed: a name"),
    (lambda: bojax.run(CONFIG, out=3), "^out: got 3, of type int; allowed: a path$"),
    (lambda: bojax.run(CONFIG, out=""), '^out: got "", of type str; allowed: a path$'),
    (lambda: bojax.load(None), "^folder: got null, of type NoneType; allowed: a path$"),
    (lambda: bojax.run({**CONFIG, "episodse": 1}), 'episodse: unknown key.*did you mean "episodes"'),
    (lambda: bojax.run({"base": "chain"}), "config.yaml: is a sweep, not an experiment"),
    (lambda: bojax.sweep(CONFIG), "config.yaml: base: missing"),
    (lambda: bojax.run(CONFIG, resume=True), "no unfinished sweep to resume"),
    (lambda: bojax.run({**CONFIG, "env": int}), 'got "builtins:int"; the class does not implement'),
    (lambda: bojax.tune(CONFIG, {DISCOUNT: 1}), "learner.discount: got 1; allowed: .low, high"),
    (
        lambda: bojax.tune(CONFIG, {DISCOUNT: [0.5]}),
        "learner.discount: got .*; allowed: at least two numbers",
    ),
    (lambda: bojax.tune(CONFIG, {"learner": ["additive", "aditive"]}), 'got "aditive"; unknown learner'),
    (lambda: bojax.tune(CONFIG, {DISCOUNT: (1, 0.5)}), "got 1:0.5; allowed: low:high with low"),
    (lambda: bojax.tune(CONFIG, {DISCOUNT: (0.5, 1)}, budget=3), "--budget: got 3; allowed: >="),
    (lambda: bojax.tune("chian", {DISCOUNT: (0.5, 1)}), 'did you mean "chain"'),
    (lambda: bojax.run(CONFIG, out=__file__), "is not a folder; allowed: a new or empty folder"),
]


def test_a_mistake_is_one_line_before_anything_is_written(here):
    assert_refused(MISTAKES, bojax.BojaxError)
    assert [path for path in here.rglob("*") if path.is_file()] == []


def test_an_error_of_the_process_is_one_line(here):
    (here / "my_envs.py").write_text("import os\n\nos.kill(os.getpid(), 9)\n")
    with pytest.raises(bojax.BojaxError, match="ended by SIGKILL; nothing was written$"):
        bojax.run(CONFIG, env="my_envs:Chain")
    (here / "my_envs.py").write_text("import math\n\nmath.sqrt(-1)\n")
    with one_line(bojax.BojaxError, "importing my_envs failed: ValueError"):
        bojax.run(CONFIG, env="my_envs:Chain")
    assert list(here.glob("results/*/*")) == []


def test_a_class_that_cannot_be_traced_is_refused(here, caller):
    env = {"kind": Broken, "rewards": (1.0, 2.0)}
    with one_line(bojax.BojaxError, "env: Broken: .* ZeroDivisionError: no such arm"):
        bojax.run({**ARMS, "env": env}, out="broken")
    assert not (here / "broken").exists()


def test_a_failure_in_this_process_is_one_line(caller, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("no such arm")

    monkeypatch.setattr("bojax.experiments.learning.run_episode", fail)
    message = "1 of 1 chunks failed: ZeroDivisionError: no such arm"
    with one_line(bojax.BojaxError, message):
        bojax.run(ARMS, out="broken")


def test_a_signal_during_the_report_ends_it_at_once(here, caller, monkeypatch, capsys):
    """There is no checkpoint to wait for. The process gets SIGTERM when its caller is gone."""
    handlers = []

    def report(folder):
        handlers.append(signal.getsignal(signal.SIGTERM))
        signal.raise_signal(signal.SIGINT)
        (here / "report.html").touch()

    monkeypatch.setattr("bojax.report.progress.report", report)
    with pytest.raises(bojax.Interrupted, match="the runs are finished; .* bojax report arms$"):
        bojax.run(ARMS, out="arms", episodes=2)
    assert handlers == [signal.SIG_DFL] and not (here / "report.html").exists()
    assert read_manifest(here / "arms")["status"] == "finished"
    assert "stopping after" not in capsys.readouterr().err


@pytest.fixture
def interrupt(monkeypatch):
    """Sends this process a SIGINT at the first line of the command that contains each text, in turn."""
    take = Output.take

    def arrange(*texts: str) -> None:
        left = list(texts)

        def taken(self, line):
            if left and left[0] in line:
                del left[0]
                os.kill(os.getpid(), signal.SIGINT)
            take(self, line)

        monkeypatch.setattr(Output, "take", taken)

    return arrange


def test_ctrl_c_stops_at_a_checkpoint_and_the_sweep_is_resumed(here, interrupt, caller):
    interrupt('"title"')
    config = {**CONFIG, "episodes": 40, "engine": {"segment_seconds": 0.01}}
    message = "interrupted; to resume: bojax.run.config, runs=2, out='cut', resume=True"
    with pytest.raises(bojax.Interrupted, match=message):
        bojax.run(config, runs=2, out="cut")
    assert is_unfinished(here / "cut") and read_manifest(here / "cut")["status"] == "interrupted"
    with pytest.raises(bojax.BojaxError, match="this sweep has not finished"):
        bojax.load("cut")
    resumed = bojax.run(config, runs=2, out="cut", resume=True)
    assert resumed.episodes["episode"].to_pylist() == [*range(1, 41)] * 2


def test_ctrl_c_twice_leaves_at_once(here, interrupt):
    interrupt('"title"', "stopping after this segment")
    with pytest.raises(bojax.Interrupted, match="resume=True"):
        bojax.run({**CONFIG, "episodes": 5000, "engine": {"segment_seconds": 60.0}}, out="cut")
    assert is_unfinished(here / "cut") and read_manifest(here / "cut")["status"] == "running"


def test_a_second_signal_does_not_end_the_process_of_the_caller():
    said = threading.Semaphore(0)
    with signals.StopRequest(lambda text: said.release(), exits=False) as stop:
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGINT)
            assert said.acquire(timeout=10)
    assert stop.exit_code == 130


@pytest.mark.parametrize(("given", "asked"), [(None, [7, 7, 1]), (7, [7, 1]), (7, [1])])
def test_a_process_ends_with_the_one_that_started_it(monkeypatch, given, asked):
    """That one may have ended before it is asked for: then another one has taken its place."""
    parents, sent = iter(asked), []
    monkeypatch.setattr(signals.os, "getppid", lambda: next(parents))
    monkeypatch.setattr(signals.os, "kill", lambda process, number: sent.append((process, number)))
    monkeypatch.setattr(signals.time, "sleep", lambda seconds: None)
    signals.stop_with_parent(given).join(10)
    assert sent == [(os.getpid(), signal.SIGTERM)]
