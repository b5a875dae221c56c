"""The examples run: the very commands of the pages, with tiny budgets.

The normal tier runs what compiles within three seconds, among it a planner, a learner and a problem by their
import paths, and `test_pages` validates all commands; the slow tier runs all of them.
"""

import os
import re
import runpy
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest

from bojax.cli.main import main
from bojax.results.store import read_manifest, read_table
from tests.examples.pages import PAGES, ROOT, commands
from tests.tiers import by_tier

TINY = ("planner.depth=1", "problem.max_steps=2", "record.runs=1", "--runs", "2")
FILES = [path for path in (ROOT / "examples").iterdir() if path.is_file()]


def _uses_example(words: list[str]) -> bool:
    if words[1:2] in (["render"], ["compare"]):  # of results that another command makes
        return False
    return any(path.name in word or f"={path.stem}:" in word for word in words for path in FILES)


CHECKS: dict[str, Callable[[dict[str, list[float]]], bool]] = {
    "brax_training.py": lambda of: -1000.0 < of["mean return of 16 episodes"][0] < 0.0,
    "bayesian_optimisation.py": lambda of: min(of["best"][0], of["best of 100 runs, median"][0]) > -1.0,
    "estimators.py": lambda of: of["score of the process"][0] > 0.9 > of["score of the line"][0],
    "fit_a_gp.py": lambda of: of["log marginal likelihood"][0] < of["log marginal likelihood"][1],
    "gymnasium_loop.py": lambda of: (
        of["steps to the goal"][0] < 150 and of["reward of the last one"][0] == 1.0
    ),
    "linear_models.py": lambda of: np.allclose(of["one by one"], of["batch"], rtol=1e-5),
    "minimise.py": lambda of: of["best"][-1] < 0.01 and Path("minimise.png").stat().st_size > 10_000,
    "my_robot_env.py": lambda of: len(of["episodes to the pocket"]) >= 2,
    "my_field.py": lambda of: max(of["RMSE"]) < 0.4,
    "my_robot.py": lambda of: of["samples"] == [100.0] and 0.5 < of["field at the peak"][0] < 1.2,
    "plot_a_gp.py": lambda _: Path("gp.png").stat().st_size > 10_000,
    "survey_robot.py": lambda of: of[""][-1] < 0.3,  # mean deviation of the depth, m
    "survey_ros2.py": lambda of: of[""][0] >= 2.0,  # plans
    "sweep_in_python.py": lambda of: len(of["steps to the goal"]) == 2 and of["success of the best"][0] > 0.9,
    "train_emu_q.py": lambda of: (
        max(of["episodes to the goal"]) <= 5 and of["steps of what run 0 has learned"][0] < 300
    ),
    "vector_of_envs.py": lambda of: (
        of["goals of 64 cars in 300 steps"][0] >= 64 and of["goals of 64 compiled cars"][0] >= 64
    ),
    "plan_once.py": lambda of: len(of[""]) == 31,
}
"""Checks of the numbers that an example prints, by the words before them."""

ALONE = "plan_once.py"
"""The program that runs in a process of its own."""

DEEP_RL = "deep_rl.py"
"""The program that trains for minutes."""

SHOWN = {tuple(words): None for page in PAGES for words in commands(page)}
WITH_EXAMPLES = [list(words) for words in SHOWN if _uses_example(list(words))]
COMMANDS = [words for words in WITH_EXAMPLES if words[0] == "bojax" and words[1] != "survey"]
SURVEYS = [words for words in WITH_EXAMPLES if words[:2] == ["bojax", "survey"]]
WIDE = [
    words for page in PAGES if (of := commands(page)).count(["export", "JAX_ENABLE_X64=1"]) for words in of
]
"""Commands of pages that enable 64-bit numbers."""

PROGRAMS = [words for words in WITH_EXAMPLES if words[0] != "bojax" and words[1] not in (ALONE, DEEP_RL)]

QUICK = ("gymnasium_loop.py", "linear_models.py", "my_robot.py", "plot_a_gp.py", "vector_of_envs.py")
"""Programs of the normal tier."""


def _is_quick(words: list[str]) -> bool:
    """Whether the normal tier runs a command."""
    is_of_part = any(word.startswith(("planner=my_planner", "learner=my_learner")) for word in words)
    return is_of_part or {"my_problem.yaml", "planner=sbo"} <= {*words}


@pytest.fixture
def folder(tmp_path, monkeypatch, usual_jax):
    """A working directory with the examples, and JAX as a user has it."""
    shutil.copytree(ROOT / "examples", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    yield tmp_path
    for path in FILES:
        sys.modules.pop(path.stem, None)
    jax.clear_caches()  # no two examples share a program: a worker would grow to 2 GB


@pytest.mark.parametrize(
    "words",
    by_tier(PROGRAMS, normal=[words for words in PROGRAMS if words[1] in QUICK]),
    ids=[" ".join(words) for words in PROGRAMS],
)
def test_a_program_of_the_pages_runs(words, folder, capsys):
    jax.config.update("jax_enable_x64", words in WIDE)
    runpy.run_path(words[1], run_name="__main__")
    printed = capsys.readouterr().out
    assert "nan" not in printed
    assert CHECKS[words[1]](_numbers(printed)), printed


def test_a_program_runs_in_a_process_of_its_own(folder):
    command = [sys.executable, ALONE]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, ran.stderr
    assert CHECKS[ALONE](_numbers(ran.stdout)), ran.stdout


@pytest.mark.slow
def test_curves_of_deep_rl_are_compared(folder):
    command = [sys.executable, DEEP_RL, *"mountain-car --runs 1 --steps 2048 --evaluations 2".split()]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert ran.returncode == 0, ran.stderr
    assert len(re.findall("share of episodes with success", ran.stdout)) == 4
    table = np.genfromtxt("results/deep_rl.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert set(table["x"]) >= {0, 2048} and set(table["task"]) == {"mountain-car"}
    words = ["compare", "--csv", "results/deep_rl.csv", "--metric", "success", "--x", "step", "--out", "out"]
    assert main(words) == 0
    assert "sac (classic)" in (folder / "out" / "comparison.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "words",
    by_tier(COMMANDS, normal=[words for words in COMMANDS if _is_quick(words)]),
    ids=[" ".join(words) for words in COMMANDS],
)
def test_a_command_of_the_pages_runs(words, folder):
    assert main([*words[1:], *_tiny(words), "--out", "out"]) == 0
    if (folder / "out" / "learners").exists():
        _evaluate(folder)
    manifest = read_manifest(folder / "out")
    runs = read_table(folder / "out" / "runs.parquet")
    assert manifest["status"] == "finished"
    assert runs.num_rows == 2 * len(manifest["points"]) and sum(runs["nans"].to_pylist()) == 0
    assert (folder / "out" / "report.html").exists()
    if (model := folder / f"{Path(words[2]).stem}.xml").exists():
        _render(folder / "out", model)


@pytest.mark.slow
@pytest.mark.parametrize("words", SURVEYS, ids=[" ".join(words) for words in SURVEYS])
def test_a_survey_of_the_pages_is_planned(words, folder):
    assert main([*words[1:], "--out", "out"]) == 0
    robots = int(words[words.index("--robots") + 1]) if "--robots" in words else 1
    assert len(list((folder / "out").glob("waypoints*.csv"))) == robots
    assert (folder / "out" / "report.html").exists()


def _render(folder, model) -> None:
    """Draw a film of a user's robot, where this machine can draw."""
    from bojax.films.rendering import CannotDraw, backend

    try:
        backend()
    except CannotDraw:
        return
    assert main(["render", str(folder), "--model", str(model)]) == 0
    assert len(list((folder / "animations").glob("*.gif"))) == 1


def _evaluate(folder) -> None:
    """A saved learner runs like any other config, and does not explore."""
    assert main(["run", "out/learners/0", "episodes=3", "--out", "again"]) == 0
    episodes = read_table(folder / "again" / "episodes.parquet")
    assert episodes["kappa"].to_pylist() == [0.0] * 3


def _tiny(words: list[str]) -> tuple[str, ...]:
    """Overrides with small budgets: a planner that does not search has no depth, a learner no planner.

    A command that is about a field takes the planner that compiles fastest; others of the same config search.
    """
    if any(name in word for word in words for name in ("my_env", "my_learner", "my_gym_env", "my_robot_env")):
        return ("episodes=2", "env.max_steps=15", *TINY[2:])
    if "my_hiker_planners.yaml" in words:  # planners are what it sweeps
        return TINY[1:]
    if any("problem.field=" in word for word in words):
        return ("planner=random", *TINY[1:-3], "record.runs=0", *TINY[-2:])
    if words[2].endswith(".yaml") and any("=" in word for word in words[3:]):
        # A film of this config is drawn without the overrides.
        return (*TINY[:-3], "record.runs=0", *TINY[-2:])
    return TINY[1:] if any("my_planner" in word for word in words) else TINY


def _numbers(text: str) -> dict[str, list[float]]:
    """The numbers of each line that begins with words and a colon, and of the lines that follow it."""
    parts = re.split(r"^([A-Za-z][^:\n]*):", "\n" + text, flags=re.MULTILINE)
    names, values = ["", *parts[1::2]], parts[0::2]
    found = [re.findall(r"-?\d[\d.]*(?:e[-+]?\d+)?", value) for value in values]
    return dict(zip(names, [[float(word) for word in words] for words in found], strict=True))
