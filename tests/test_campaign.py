"""The campaign judges as it says and repeats its cases; in the slow tier a few of them hold."""

import itertools
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.campaign import configs, damage
from benchmarks.campaign.case import Outcome, Tally, fault_of, table
from benchmarks.campaign.process import ChildResult
from benchmarks.campaign.workloads import difference

ROOT = Path(__file__).parents[1]


def ended(code: int, err: str = "", *, is_late: bool = False) -> ChildResult:
    return ChildResult(code=code, out="", err=err, wall=1.0, cpu=1.0, megabytes=100.0, is_late=is_late)


TRACEBACK = 'Traceback (most recent call last):\n  File "/x/bojax/a.py", line 3, in f\nKeyError: 1\n'
JUDGED = [
    (ended(2, "error: a.yaml: runs: got 0; allowed: >= 1\n"), ""),
    (ended(0, "warning: 2 runs with NaN\n"), ""),
    (ended(130, "interrupted\n"), ""),
    (ended(-9), ""),
    (ended(-11), "exit code -11"),
    (ended(1, "error: it failed\n"), "exit code 1"),
    (ended(2), "0 of them errors"),
    (ended(2, "error: one\nerror: two\n"), "2 of them errors"),
    (ended(2, "a warning\nerror: one\n"), "2 lines"),
    (ended(0, "error: all is lost\n"), "exit code 0"),
    (ended(2, "error: " + "x" * 1000), "1007 characters"),
    (ended(2, "error: \x1b[31mred"), "'\\x1b'"),
    (ended(2, "", is_late=True), "not over"),
    (ended(2, TRACEBACK), "KeyError: 1 (bojax/a.py, line 3)"),
]


def test_judgement():
    for end, said in JUDGED:
        fault = fault_of(end, (0, 2, 130, -9), alone=True)
        assert said in fault and bool(fault) == bool(said)


def test_every_byte_is_compared():
    wanted = {"runs.parquet": b"ab", "arrays/0.npz": b"c"}
    assert difference(dict(wanted), wanted) == ""
    assert "runs.parquet" in difference({**wanted, "runs.parquet": b"aB"}, wanted)
    assert "arrays/0.npz" in difference({"runs.parquet": b"ab"}, wanted)


def test_table_counts():
    tallies = {"kills": Tally(5, [(3, Outcome("toy", "lost"))]), "disk": Tally(2, [])}
    assert table(tallies, markdown=True).splitlines()[2:] == ["| kills | 5 | 4 | 1 |", "| disk | 2 | 2 | 0 |"]
    assert table(tallies, markdown=False).splitlines()[1].split() == ["kills", "5", "4", "1"]


def written(folder: Path) -> dict[str, bytes | None]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
        if not path.is_symlink()
    }


def test_inputs_follow_from_the_seed(tmp_path):
    for seed, family in itertools.product(range(4), configs.FAMILIES):
        found = []
        for name in ("a", "b"):
            place = tmp_path / f"{family.__name__}{seed}{name}"
            place.mkdir()
            found.append((family(random.Random(seed), place), written(place)))
        assert found[0] == found[1], family.__name__


def test_damage_follows_from_the_seed_and_damages(tmp_path):
    original = {f"piece-{index:06d}-steps.json": b'{"a": [1, 2], "b": {"c": 3.5}}' for index in range(4)}
    changed = 0
    for seed in range(30):
        found = []
        for name in ("a", "b"):
            place = tmp_path / f"{seed}{name}" / "work"
            place.mkdir(parents=True)
            for file, content in original.items():
                (place / file).write_bytes(content)
            done = damage.damage(random.Random(seed), place.parent)
            found.append((done, written(place)))
        assert found[0] == found[1]
        changed += found[0][1] != original
    assert changed >= 25  # a file copied over its equal is none


def campaign(*words: str) -> list[str]:
    """The words of the table that the campaign prints."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "benchmarks.campaign", *words]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.split()


linux = pytest.mark.skipif(
    sys.platform != "linux", reason="the campaign limits and ends processes as Linux does"
)


@linux
@pytest.mark.slow
def test_some_cases_hold():
    assert len(campaign("--quick")) >= 20


@linux
@pytest.mark.slow
def test_drivers_and_workers_that_are_lost():
    assert len(campaign("--only", "launches", "--count", "5")) >= 8
