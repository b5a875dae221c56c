"""An interrupted sweep, resumed, ends in the same bytes as an undisturbed one."""

import json
import os
import signal
import time
from pathlib import Path

import pytest

from bojax.results.store import WORK, read_manifest
from tests.engine.drive import contents, run_toy, start_toy

POINTS = ({"scale": 1.0, "max_length": 400}, {"scale": 2.0, "max_length": 400}, {"max_length": 30})
"""Two static groups: the first takes a hundred segments and more."""

SWEEP = {"points": POINTS, "runs": 6, "lanes_per_device": 4}
OFTEN = {"segment_seconds": 1e-6, "checkpoint_seconds": 1e-6}
"""Every advance is a segment and leaves a checkpoint."""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed") / "toy"
    assert run_sweep_here(out) == 0
    return out


def run_sweep_here(out: Path, **settings) -> int:
    given = {**SWEEP, **settings}
    return run_toy(out, *given.pop("points"), **given)


def wait_for_checkpoint(out: Path, advances: int) -> None:
    """Wait until some chunk has a checkpoint after at least so many advances."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        for path in (out / WORK).glob("chunk-*/state.json"):
            state = json.loads(path.read_text())
            if state["checkpoint"] and state["advances"] >= advances:
                return
        time.sleep(0.01)
    raise AssertionError(f"no checkpoint in {out}")


def stop_in_the_middle(out: Path, number: signal.Signals) -> tuple[int, str]:
    process = start_toy(out, **{**SWEEP, **OFTEN})
    wait_for_checkpoint(out, advances=5)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    return process.returncode, errors


def test_killed_and_resumed(tmp_path, undisturbed):
    out = tmp_path / "toy"
    code, _ = stop_in_the_middle(out, signal.SIGKILL)
    assert code == -signal.SIGKILL
    assert not (out / "runs.parquet").exists()
    assert read_manifest(out)["status"] == "running"
    assert run_sweep_here(out, resume=True) == 0
    assert contents(out) == contents(undisturbed)
    assert not (out / WORK).exists()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted_and_resumed(tmp_path, undisturbed, number, code):
    out = tmp_path / "toy"
    found, errors = stop_in_the_middle(out, number)
    assert found == code
    assert errors.splitlines()[-1].strip() == f"bojax sweep toy --out {out} --resume"
    assert read_manifest(out)["status"] == "interrupted"
    assert run_sweep_here(out, resume=True) == 0
    assert contents(out) == contents(undisturbed)


def test_second_signal_leaves_at_once(tmp_path):
    out = tmp_path / "toy"
    # The first signal is never looked at: only the second one can end this process.
    deaf = "from bojax.engine.signals import StopRequest; StopRequest.__bool__ = lambda self: False"
    points = ({"max_length": 1_000_000},)
    process = start_toy(out, deaf, points=points, runs=2, **OFTEN)
    wait_for_checkpoint(out, advances=2)
    process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=10) == 130


@pytest.fixture
def interrupted(tmp_path) -> Path:
    """A folder whose first chunk stopped at a checkpoint, made without a process of its own."""
    out = tmp_path / "toy"
    assert stop_after(out, segments=3) == 130
    return out


def stop_after(out: Path, segments: int, **settings) -> int:
    from bojax.engine.runner import ChunkRunner

    original, count = ChunkRunner._advance, 0

    def advance(self, *arguments):
        nonlocal count
        result = original(self, *arguments)
        count += 1
        if count == segments:
            os.kill(os.getpid(), signal.SIGINT)
            while not self.stop:
                time.sleep(0.001)
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChunkRunner, "_advance", advance)
        return run_sweep_here(out, **{**OFTEN, **settings})


def one_line(capsys) -> str:
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    return lines[0]


def test_resume_twice(interrupted, undisturbed):
    assert stop_after(interrupted, segments=2, resume=True) == 130
    assert run_sweep_here(interrupted, resume=True) == 0
    assert contents(interrupted) == contents(undisturbed)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"runs": 7}, "runs: 6 -> 7"),
        ({"seed": 4}, "seed: 3 -> 4"),
        ({"points": ({"scale": 1.5, "max_length": 400}, *POINTS[1:])}, "config.scale: 1.0 -> 1.5"),
        ({"points": (*POINTS[:2], {"max_length": 31})}, "points.2.config.max_length: 30 -> 31"),
        ({"lanes_per_device": 5}, "lanes_per_device.0: 4 -> 5"),
    ],
)
def test_changed_config_is_refused(interrupted, capsys, change, named):
    before = sorted(interrupted.rglob("*"))
    capsys.readouterr()
    assert run_sweep_here(interrupted, resume=True, **change) == 2
    assert named in one_line(capsys)
    assert sorted(interrupted.rglob("*")) == before


def test_changed_code_is_refused(interrupted, capsys, monkeypatch):
    monkeypatch.setattr("bojax.engine.plan.code_hashes", lambda modules: {"bojax": "another"})
    capsys.readouterr()
    assert run_sweep_here(interrupted, resume=True) == 2
    assert "code.bojax: " in one_line(capsys)


def test_segments_and_reports_may_change(interrupted, undisturbed):
    assert run_sweep_here(interrupted, resume=True, segment_seconds=0.5, checkpoint_seconds=9.0) == 0
    assert contents(interrupted) == contents(undisturbed)


@pytest.mark.parametrize("name", ["part-000000-steps.parquet", "state.json"])
def test_truncated_file(interrupted, capsys, name):
    (path,) = interrupted.glob(f"{WORK}/chunk-*/{name}")
    path.write_bytes(path.read_bytes()[:-20])
    capsys.readouterr()
    assert run_sweep_here(interrupted, resume=True) == 2
    line = one_line(capsys)
    assert str(path) in line and "delete the folder" in line


def test_truncated_checkpoint(interrupted, capsys):
    for path in interrupted.glob(f"{WORK}/chunk-*/checkpoint-*/**/*"):
        if path.is_file():
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    capsys.readouterr()
    assert run_sweep_here(interrupted, resume=True) == 2
    line = one_line(capsys)
    assert "checkpoint cannot be read" in line and "delete the folder" in line


def test_deleting_a_bad_chunk_mends_it(interrupted, undisturbed):
    (chunk,) = {path.parent for path in interrupted.glob(f"{WORK}/chunk-*/checkpoint-*")}
    for path in sorted(chunk.rglob("*"), reverse=True):
        path.unlink() if path.is_file() else path.rmdir()
    chunk.rmdir()
    assert run_sweep_here(interrupted, resume=True) == 0
    assert contents(interrupted) == contents(undisturbed)


def test_newest_unfinished_folder_is_taken(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    root = Path("results/toy")
    assert run_sweep_here(None, resume=True) == 2
    assert "no unfinished sweep" in one_line(capsys)
    assert stop_after(root / "20260101-000000", segments=1) == 130
    assert stop_after(root / "20260102-000000", segments=1) == 130
    assert run_sweep_here(root / "20260103-000000") == 0
    assert run_sweep_here(None, resume=True) == 0
    assert (root / "20260102-000000" / "runs.parquet").exists()
    assert not (root / "20260101-000000" / "runs.parquet").exists()


def test_folder_in_use(interrupted, capsys):
    process = start_toy(interrupted, resume=True, points=({"max_length": 1_000_000},), runs=2)
    process.wait(timeout=60)
    assert process.returncode == 2  # another sweep: refused, and the lock is released
    from bojax.results.folder import RunFolder

    holder = RunFolder(interrupted)
    holder._take_lock()
    capsys.readouterr()
    assert run_sweep_here(interrupted, resume=True) == 2
    assert "another process" in one_line(capsys)
    holder.close(finished=False)
    assert run_sweep_here(interrupted, resume=True) == 0
