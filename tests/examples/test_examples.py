"""The examples run: the very commands of the pages, with tiny budgets."""

import os
import shutil
import subprocess
import sys

import pytest

from bojax.results.store import read_manifest, read_table
from tests.examples.pages import PAGES, ROOT, commands

TINY = ("planner.depth=1", "problem.max_steps=2", "engine.latency=false", "record.runs=1", "--runs", "2")
FILES = [path for path in (ROOT / "examples").iterdir() if path.is_file()]


def _uses_example(words: list[str]) -> bool:
    return any(path.name in word or f"={path.stem}:" in word for word in words for path in FILES)


COMMANDS = [words for page in PAGES for words in commands(page) if _uses_example(words)]


@pytest.mark.parametrize("words", COMMANDS, ids=[" ".join(words) for words in COMMANDS])
def test_a_command_of_the_pages_runs(words, tmp_path):
    shutil.copytree(ROOT / "examples", tmp_path, dirs_exist_ok=True)
    if words[0] == "bojax":
        command = [sys.executable, "-m", *words, *_tiny(words), "--out", "out"]
    else:
        command = [sys.executable, *words[1:]]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    ran = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, ran.stderr
    if words[0] == "python":
        assert len(ran.stdout.splitlines()) == 11
        return
    manifest = read_manifest(tmp_path / "out")
    runs = read_table(tmp_path / "out" / "runs.parquet")
    assert manifest["status"] == "finished"
    assert runs.num_rows == 2 * len(manifest["points"]) and sum(runs["nans"].to_pylist()) == 0
    assert (tmp_path / "out" / "report.html").exists()


def _tiny(words: list[str]) -> tuple[str, ...]:
    """Budgets for a command: a planner that does not search has no depth."""
    return TINY[1:] if any("my_planner" in word for word in words) else TINY
