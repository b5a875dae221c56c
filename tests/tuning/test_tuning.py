"""`bojax tune` finds settings in rounds, goes on after a kill, and refuses bad input in one line."""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from bojax.api.errors import BojaxError
from bojax.api.results import TuningResults
from bojax.cli.main import main
from bojax.config.sweep import load_config
from bojax.engine import batch
from bojax.engine.worker import run_worker
from bojax.report.source import load
from bojax.report.text import seconds
from bojax.results.folder import make_new
from bojax.tuning.page import _confirmed, _ranked, _summary, read_tuning
from bojax.tuning.rounds import _Rounds
from tests.engine.in_process import InProcessLauncher
from tests.engine.test_program_cache import caching_in
from tests.transcript import cases

ROOT = Path(__file__).parents[2]

CHAIN = ["chain", "env.length=5", "env.max_length=5", "env.max_steps=40", "episodes=12", "learner=additive"]
RANGES = ["learner.learning_rate=0.05:1:log", "learner.discount=0.5:1"]
OPTIONS = ["--metric", "steps_to_goal", "--minimise", "--batch", "3", "--runs", "4", "--confirm", "4"]
OFTEN = ["engine.segment_seconds=0.000001", "engine.checkpoint_seconds=0.000001"]
WORDS = [*CHAIN, *RANGES, *OPTIONS, *OFTEN]


def tune(out, *more: str, rounds: int = 3) -> int:
    return main(["tune", *WORDS, "--budget", str(12 * rounds), "--out", str(out), *more])


def contents(folder: Path) -> dict[str, bytes]:
    """All content of a search that an interruption must not change."""
    files = [*folder.rglob("runs.parquet"), folder / "tuning.json", folder / "best.yaml"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_ctrl_c_during_the_import_of_jax_is_not_lost(tmp_path, capfd, monkeypatch):
    """There, the KeyboardInterrupt may be raised in a callback, which discards it."""

    def interrupt(*_):
        os.kill(os.getpid(), signal.SIGINT)
        with contextlib.suppress(KeyboardInterrupt):
            time.sleep(0.3)
        return ()

    monkeypatch.setattr("bojax.tuning.task._recompiled", interrupt)
    assert tune(tmp_path / "search") == 130
    assert capfd.readouterr().err == "interrupted\n" and not (tmp_path / "search").exists()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed") / "search"
    assert tune(out) == 0
    return out


def test_a_search_writes_its_rounds_the_best_config_and_fresh_runs(undisturbed):
    tuning = read_tuning(undisturbed)
    assert len(tuning.points) == 9 and not (undisturbed / ".work").exists()
    for number in range(3):
        results = load(undisturbed / "rounds" / f"{number:03d}")
        assert results.runs["run"].tolist() == [0, 1, 2, 3] * 3 and results.manifest.seed == 0
    assert tuning.best.mean == min(point.mean for point in tuning.points)
    config = load_config(yaml.safe_load((undisturbed / "best.yaml").read_text())).points[0].config
    assert tuning.best.values == [config.learner.learning_rate, config.learner.discount]
    fresh = load(undisturbed / "confirm-9-4")
    assert fresh.manifest.seed == 1 and len(fresh.points) == 4
    assert list(fresh.points[0].swept.values()) == tuning.best.values
    assert list(fresh.points[-1].swept.values()) == [0.1, 0.99]  # as written in the config
    page = (undisturbed / "report.html").read_text()
    cells = re.findall(r'"in the search" data-sort="(.*?)"><span>(.*?)<', page)
    assert len(cells) == 4  # sorted by their place in the search
    assert all(key == (text.split(" of ")[0] if " of " in text else "") for key, text in cells)
    assert "as written in the config" in page and "learner.learning_rate" in page
    manifests = [load(path.parent).manifest for path in undisturbed.rglob("manifest.json")]
    run, build = (sum(getattr(each, f"{name}_seconds") for each in manifests) for name in ("run", "compile"))
    assert len(manifests) == 4 and f"{seconds(run)} of run time, {seconds(build)} of compilation" in page


def test_the_page_says_what_fresh_runs_show_of_the_best_setting(undisturbed):
    tuning, fresh = read_tuning(undisturbed), load(undisturbed / "confirm-9-4")
    first, second, written = (fresh.runs["point"] == index for index in (0, 1, 3))
    fresh.runs.update({name: values.copy() for name, values in fresh.runs.items()})
    times = fresh.runs["steps_to_goal"]
    assert tuning.written == [0.1, 0.99]
    for steps, is_told in ((10, False), (9, True), (8, True)):
        times[first], times[written] = 9, steps
        assert (f"as written is not worse on fresh runs: {steps} [" in _summary(tuning, fresh)) == is_told
    alike = "Equal in every run: 1 of 9 and 2 of 9; what they differ in has no effect there."
    assert alike not in _confirmed(tuning, fresh).caption
    for column in fresh.measured(fresh.runs):
        fresh.runs[column][second] = fresh.runs[column][first]
    assert alike in _confirmed(tuning, fresh).caption
    caption = _ranked(tuning).caption
    assert "leave out the luck of the runs" in caption and "Score: mean steps to goal, or" in caption


def test_python_reads_what_a_search_has_found(undisturbed):
    found, tuning = TuningResults(undisturbed), read_tuning(undisturbed)
    points = found.points.to_pylist()
    assert [point["mean"] for point in points] == [tuning.points[index].mean for index in tuning.order]
    best = [points[0][key] for key in ("learner.learning_rate", "learner.discount")]
    assert best == tuning.best.values and found.best["learner"]["discount"] == best[1]
    assert found.confirmed is not None and found.confirmed.runs.num_rows == 16
    assert "learner.discount" in repr(found) and found.report.is_file()
    with pytest.raises(BojaxError, match="no such file"):
        TuningResults(undisturbed / "rounds")


def test_the_score_is_the_mean_over_the_runs_of_a_point(undisturbed):
    tuning = read_tuning(undisturbed)
    for index, point in enumerate(tuning.points):
        results = load(undisturbed / "rounds" / f"{index // 3:03d}")
        longest = load(undisturbed / "rounds" / "000").runs["steps"].max()
        times = np.fmin(results.runs_of(results.points[index % 3])["steps_to_goal"], longest)
        assert times.mean() == pytest.approx(point.score, rel=1e-12)


def test_times_of_every_round_count_up_to_the_longest_run_of_the_first(tmp_path, undisturbed, monkeypatch):
    out = shutil.copytree(undisturbed, tmp_path / "search")

    def without_goals(folder):
        results = load(folder)
        if folder.name == "001":
            never = np.full(results.runs["steps"].size, np.nan)
            results.runs.update(steps=3 * results.runs["steps"], steps_to_goal=never)
        return results

    monkeypatch.setattr("bojax.tuning.rounds.load", without_goals)
    assert tune(out, "--resume", rounds=4) == 0
    longest = load(out / "rounds" / "000").runs["steps"].max()
    assert [point.score for point in read_tuning(out).points if point.round == 1] == [longest] * 3


def test_later_rounds_compile_nothing(tmp_path, monkeypatch):
    counts, original = [batch.compile_counts.total()], _Rounds._learn

    def learn(self, number, folder):
        counts.append(batch.compile_counts.total())
        original(self, number, folder)

    monkeypatch.setattr(_Rounds, "_learn", learn)
    with caching_in(tmp_path / "cache"):
        assert tune(tmp_path / "search", "--confirm", "0") == 0
    before, first, second, third = counts
    assert before < first == second == third


KILLED = """
import os, signal, sys, tests.strict
from bojax.cli.main import main
from bojax.engine.runner import ChunkRunner
segment, count = ChunkRunner._segment, [0]
def stop(self):
    if os.path.isdir(sys.argv[-1] + "/rounds/001"): count[0] += 1
    if count[0] > 1: os.kill(os.getpid(), signal.SIGKILL)
    return segment(self)
ChunkRunner._segment = stop
main(sys.argv[1:])
"""
"""A search that ends itself in its second round."""


@pytest.mark.bits
def test_killed_inside_a_round_and_resumed(tmp_path, undisturbed):
    out = tmp_path / "search"
    words = ["tune", *WORDS, "--budget", "36", "--out", str(out)]
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, *words], cwd=ROOT, capture_output=True, timeout=300
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr.decode()
    assert (out / "rounds" / "001" / ".work").is_dir()
    assert tune(out, "--resume") == 0
    assert contents(out) == contents(undisturbed)


def test_an_interrupted_search_prints_how_to_resume_it(tmp_path, monkeypatch, capfd):
    from bojax.engine.runner import ChunkRunner

    original = ChunkRunner._segment

    def segment(self):
        os.kill(os.getpid(), signal.SIGINT)
        while not self._limits.stop():
            pass
        return original(self)

    monkeypatch.setattr(ChunkRunner, "_segment", segment)
    out = tmp_path / "search"
    assert tune(out) == 130
    last = capfd.readouterr().err.splitlines()[-1].strip()
    assert last.startswith("bojax tune chain") and last.endswith(f"--out {out} --resume")


@pytest.mark.bits
def test_workers_of_a_launcher_run_the_rounds(tmp_path, undisturbed, monkeypatch):
    launcher = InProcessLauncher(lambda folders: run_worker(folders, lambda: False, cores=1))
    monkeypatch.setattr("bojax.engine.launchers.ray_actors.Ray", lambda config: launcher)
    out = tmp_path / "search"
    closed = []
    monkeypatch.setattr(launcher, "close", lambda: closed.append(launcher.num_started))
    assert tune(out, "--launcher", "ray") == 0
    assert contents(out) == contents(undisturbed)
    assert closed == [4]  # three rounds and the confirmation by the same workers


def test_a_finished_search_goes_on_where_it_ended(tmp_path, undisturbed):
    out = shutil.copytree(undisturbed, tmp_path / "search")
    assert tune(out, "--resume", "--confirm", "0", rounds=4) == 0
    before, after = read_tuning(undisturbed).points, read_tuning(out).points
    assert [each.values for each in after[: len(before)]] == [each.values for each in before]
    assert len(after) == len(before) + 3


def test_a_finished_search_is_not_changed(tmp_path, undisturbed, capsys):
    out = shutil.copytree(undisturbed, tmp_path / "search")
    assert tune(out, "--resume") == 0
    assert contents(out) == contents(undisturbed)
    is_told = "The config as written is not worse on" in (out / "report.html").read_text()
    assert ("the config as written, which is not worse there: mean" in capsys.readouterr().out) == is_told
    assert tune(out, "--resume", "learner.initial_q=1") == 2
    assert "cannot resume, its plan has changed: config.learner: additive -> " in capsys.readouterr().err
    assert tune(out, "--resume", rounds=1) == 2
    assert f"error: {out}: has more rounds than --budget pays for; allowed: >= 36" in capsys.readouterr().err
    assert contents(out) == contents(undisturbed)


def test_a_search_that_begins_in_a_new_folder_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(_Rounds, "run", lambda self: 1)
    for more, expected in [([], ""), (["--resume"], "note: nothing to resume; starting anew: new\n")]:
        monkeypatch.chdir(make_new(tmp_path / "here"))
        assert main(["tune", *WORDS, "--out", "new", *more]) == 1
        assert capsys.readouterr().err == expected


def test_the_report_is_built_again_from_the_files(undisturbed, capsys):
    before = (undisturbed / "report.html").read_bytes()
    assert main(["report", str(undisturbed)]) == 0
    assert capsys.readouterr().out == f"{undisturbed}/report.html\n"
    assert (undisturbed / "report.html").read_bytes() == before


def test_a_damaged_file_ends_in_one_line(tmp_path, undisturbed, refusal):
    content = json.loads((undisturbed / "tuning.json").read_text())
    for name, change in (("points", "many"), ("plan", {}), ("order", [])):
        (tmp_path / "tuning.json").write_text(json.dumps({**content, name: change}))
        assert refusal(f"report {tmp_path}").startswith(f"{tmp_path}/tuning.json: ")


MISTAKES = """\
chain learner.kappa=2:1
=> command line: learner.kappa: got 2:1; allowed: low:high with low <
chain learner.kappa=0:1:log
=> command line: learner.kappa: got 0:1; allowed: low > 0, for log
chain learner.kapa=0:1
=> command line: learner.kapa: unknown key
chain learner.discount=0.5:2
=> command line: learner.discount: got 2; allowed: <= 1
chain learner.ties=0:1
=> command line: learner.ties: got 0; allowed:
chain learner=0:1
=> command line: learner: got 0; unknown learner
chain seed=0:9
=> command line: seed: got 0:9; allowed: settings of the experiment
chain learner.kappa=0:1 learner.kappa=2
=> command line: learner.kappa: given twice
chain learner.kappa=0:1 learner.kappa=0:2
=> command line: learner.kappa: given twice
chain learner.kappa=0:1 --metric ''
=> --metric: got ""; allowed: a column
chain learner.kappa=0:1 --metric retrun
=> bojax tune: --metric: got retrun; unknown column
chain learner.kappa=0:1 --metric return
=> bojax tune: --metric: got return; unknown column; allowed:
chain learner.kappa=0:1 --budget 63
=> bojax tune: --budget: got 63; allowed: >= 64
chain learner.kappa=0:1 --budget 640000
=> bojax tune: --budget: got 640000, which is 80000
chain learner.kappa=0:1 --batch 0
=> --batch: got 0; allowed: >= 1
chain learner.kappa=0:1 --confirm -1
=> --confirm: got -1; allowed: >= 0
chain learner.kappa=0:1 --runs 0
=> command line: runs: got 0; allowed: >= 1
chain learner.kappa=3
=> bojax tune: got no range; allowed: key=low:high
chain learner=additive,
=> command line: learner: got additive,; allowed: choices that differ
chain learner=additive,aditive
=> command line: learner: got "aditive"; unknown learner
chain learner.kappa=1,1.0
=> command line: learner.kappa: got 1,1.0; allowed: choices that differ
chain env.length=4,5.5
=> command line: env.length: got 5.5; allowed: an integer
chain learner=additive,epsilon-greedy learner.xi=0.1:1
=> command line: learner.xi: unknown key
chain seed=1,2
=> command line: seed: got 1,2; allowed: settings of the experiment
chain learner.kappa=0:x
=> bojax tune: got learner.kappa=0:x; allowed: key=low:high with two
chain 'env={kind: chain}'
=> bojax tune: got no range; allowed: key=low:high
learner.kappa=0:1
=> bojax tune: got none; allowed: one config
chain parking learner.kappa=0:1
=> bojax tune: got chain, parking; allowed: one config
chian learner.kappa=0:1
=> chian:
swept.yaml learner.kappa=0:1
=> swept.yaml: is a sweep, not an experiment
"""


def test_choices_of_parts_and_texts_are_part_of_the_search(tmp_path, capsys):
    """A learner, a rule for ties and a rate, which all learners have, are searched together."""
    words = [
        "learner.learning_rate=0.1:1",
        "learner=exploration-values,additive",
        "learner.ties=random,first",
        *CHAIN[:-1],
        *OPTIONS,
    ]
    assert main(["tune", *words, "--batch=2", "--budget", "16", "--out", str(tmp_path / "search")]) == 0
    tuning = read_tuning(tmp_path / "search")
    kinds = {axis.key: getattr(axis, "values", None) for axis in tuning.ranges}
    choices = {"learner": ("exploration-values", "additive"), "learner.ties": ("random", "first")}
    assert kinds == {"learner.learning_rate": None, **choices} and next(iter(kinds)) == "learner"
    assert len(tuning.points) == 4 and len({tuple(point.values) for point in tuning.points}) == 4
    for point in tuning.points:
        sweep = load(tmp_path / "search" / "rounds" / f"{point.round:03d}")
        (run,) = (each for each in sweep.points if list(each.swept.values()) == point.values)
        assert run.label == point.values[0] and run.config["learner"]["ties"] == point.values[2]
    best = yaml.safe_load((tmp_path / "search" / "best.yaml").read_text())
    learner, rate, ties = tuning.best.values
    assert best["learner"]["kind"] == learner and best["learner"]["ties"] == ties
    assert best["learner"]["learning_rate"] == rate
    assert tuning.slices[0].values == ["exploration-values", "additive"]
    page = (tmp_path / "search" / "report.html").read_text()
    assert "one of exploration-values, additive" in page and "as written in the config" in page
    finished = TuningResults(tmp_path / "search").points
    assert set(finished["learner"].to_pylist()) <= {"exploration-values", "additive"}


def test_mistakes(here, refusal):
    (here / "swept.yaml").write_text("base: chain\naxes: {learner.kappa: [0.1, 1]}\n")
    for words, message in cases(MISTAKES):
        error = refusal(f"tune {words}")
        assert error.startswith(message)
        assert not words.endswith("return") or 'did you mean "last_return"?' in error


def test_the_metric_is_a_return_and_an_integer_may_fix_a_shape(monkeypatch):
    asked = []
    monkeypatch.setattr("bojax.cli.tuning.search", lambda task, *_: asked.append(task) or 0)
    for words in (
        "parking planner.iterations=10:50 planner.exploration=1:100:log",
        "chain learner.kappa=0:1",
        "chain learner.kappa=0:1 --metric steps_to_goal",
    ):
        assert main(["tune", *words.split()]) == 0
    assert [task.column for task in asked] == ["return", "last_return", "steps_to_goal"]
    assert [task.is_least for task in asked] == [False, False, True]  # less of a time is better
    assert asked[0].recompiled == ("planner.iterations",)
    assert [each.is_integer for each in asked[0].ranges] == [True, False]


def test_an_argument_of_a_gymnasium_environment_is_tuned(here, monkeypatch):
    """It has no declared type: the config decides whether it is an integer, and without it the bounds."""
    pytest.importorskip("gymnasium")
    env = "{kind: gymnasium, id: Pendulum-v1, kwargs: {g: 9.81}}"
    (here / "my.yaml").write_text(f"{{experiment: learning, env: {env}, learner: random, episodes: 1}}")
    asked = []
    monkeypatch.setattr("bojax.cli.tuning.search", lambda task, *_: asked.append(task) or 0)
    assert main(["tune", "my.yaml", "env.kwargs.g=1:20"]) == 0
    assert main(["tune", "my.yaml", "env.kwargs={}", "env.kwargs.g=1:20"]) == 0
    assert [(each.low, each.high, each.is_integer) for task in asked for each in task.ranges] == [
        (1, 20, False),
        (1, 20, True),
    ]
