"""An interrupted sweep, resumed, ends in the same bytes as an undisturbed one."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bojax.engine.signals import StopRequest
from bojax.results.store import WORK, read_manifest
from tests.engine.clusters import wait_until
from tests.engine.drive import contents, one_error, run_toy, start_toy
from tests.tiers import by_tier

POINTS = ({"scale": 1.0, "max_length": 400}, {"scale": 2.0, "max_length": 400}, {"max_length": 30})
"""Two static groups: the first takes a hundred segments and more."""

SWEEP = {"points": POINTS, "runs": 6, "lanes_per_device": 4}
OFTEN = {"segment_seconds": 1e-6, "checkpoint_seconds": 1e-6}
"""Every advance is a segment and leaves a checkpoint."""

pytestmark = pytest.mark.usefixtures("kept_toys")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed") / "toy"
    assert run_sweep_here(out) == 0
    return out


def run_sweep_here(out: Path, **settings) -> int:
    given = {**SWEEP, **settings}
    return run_toy(out, *given.pop("points"), **given)


def wait_for_checkpoint(out: Path, process: subprocess.Popen) -> None:
    """Wait until some chunk has a checkpoint after five advances."""

    def has_some() -> bool:
        states = [json.loads(path.read_text()) for path in (out / WORK).glob("chunk-*/state.json")]
        return any(state["checkpoint"] and state["advances"] >= 5 for state in states)

    wait_until(has_some, process, seconds=120.0)


def stop_in_the_middle(out: Path, number: signal.Signals) -> tuple[int, str]:
    process = start_toy(out, **{**SWEEP, **OFTEN})
    wait_for_checkpoint(out, process)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    return process.returncode, errors


def resumes(out: Path, expected: Path, **settings) -> None:
    """Resumed, a sweep ends in the bytes of an undisturbed one, and without working files."""
    assert run_sweep_here(out, resume=True, **settings) == 0
    assert contents(out) == contents(expected)
    assert not (out / WORK).exists()


@pytest.mark.bits
@pytest.mark.parametrize(
    "number", by_tier([signal.SIGKILL, signal.SIGINT, signal.SIGTERM], normal=[signal.SIGKILL])
)
def test_stopped_and_resumed(tmp_path, undisturbed, number):
    out = tmp_path / "toy"
    found, errors = stop_in_the_middle(out, number)
    is_killed = number == signal.SIGKILL
    assert found == (-number if is_killed else 128 + number)
    assert is_killed or errors.splitlines()[-1].strip() == f"bojax sweep toy --out {out} --resume"
    assert read_manifest(out)["status"] == ("running" if is_killed else "interrupted")
    assert not (out / "runs.parquet").exists()
    resumes(out, undisturbed)


LEADER = """
import fcntl, os, signal, sys, termios
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
os.setsid()
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execvp(sys.argv[1], sys.argv[1:])
"""
"""Runs a command as the first one of a terminal."""


@pytest.mark.bits
def test_a_terminal_is_closed(tmp_path, undisturbed):
    out = tmp_path / "toy"
    quiet = "import sys; from bojax.cli.main import Messages; sys.stderr = Messages(sys.stderr)"
    terminal, inside = os.openpty()
    streams = {"stdin": inside, "stdout": inside, "stderr": inside}
    process = start_toy(
        out, quiet, before=[sys.executable, "-c", LEADER], streams=streams, **{**SWEEP, **OFTEN}
    )
    os.close(inside)
    wait_for_checkpoint(out, process)
    os.close(terminal)
    process.send_signal(signal.SIGHUP)  # a shell sends another one
    assert process.wait(60) == 128 + signal.SIGHUP
    assert read_manifest(out)["status"] == "interrupted"
    resumes(out, undisturbed)


def test_nohup_keeps_a_sweep_running():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopRequest() as stop:
            os.kill(os.getpid(), signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        assert not stop
    finally:
        signal.signal(signal.SIGHUP, before)


WAITING = """
import ctypes, sys, threading, time
from bojax.engine.signals import StopRequest
def hold():  # the interpreter's lock, longer than an echo may take
    while True:
        ctypes.PyDLL(None).usleep(300_000)
        time.sleep(0.001)
with StopRequest() as stop:
    if "busy" in sys.argv:
        threading.Thread(target=hold, daemon=True).start()
    print("ready", flush=True)
    deadline = time.monotonic() + 60
    while not stop and time.monotonic() < deadline:
        time.sleep(0.01)
    print("stopping", flush=True)
    time.sleep(1.5)
sys.exit(3 if stop else 0)
"""


@pytest.mark.parametrize("is_busy", [False, True])
def test_a_signal_to_the_process_and_to_its_group_counts_once(is_busy):
    """`timeout` sends both."""
    words = [sys.executable, "-c", WAITING, *["busy"] * is_busy]
    with subprocess.Popen(words, start_new_session=True, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGTERM)
        time.sleep(0.005)  # else the system may make one of both
        os.killpg(process.pid, signal.SIGTERM)
        assert process.wait(timeout=60) == 3


def test_a_later_signal_ends_the_process():
    with subprocess.Popen([sys.executable, "-c", WAITING], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGTERM)
        assert process.stdout.readline() == b"stopping\n"
        time.sleep(0.6)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=60) in (-signal.SIGTERM, 128 + signal.SIGTERM)


HELD = """
import ctypes, os, signal, threading
from bojax.engine.signals import StopRequest
announced = threading.Event()
with StopRequest(lambda text: announced.set()):
    os.kill(os.getpid(), signal.SIGINT)
    assert announced.wait(60)
    print("announced", flush=True)
    ctypes.PyDLL(None).sleep(600)  # with the interpreter's lock
"""


def test_second_signal_ends_a_process_whose_interpreter_is_held():
    process = subprocess.Popen([sys.executable, "-c", HELD], stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None and process.stdout.readline() == b"announced\n"
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == -signal.SIGINT
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def stopped(tmp_path_factory) -> Path:
    """A folder whose first chunk stopped at a checkpoint, made without a process of its own."""
    out = tmp_path_factory.mktemp("stopped") / "toy"
    assert stop_after(out, segments=3) == 130
    return out


@pytest.fixture
def interrupted(stopped, tmp_path) -> Path:
    return Path(shutil.copytree(stopped, tmp_path / "toy"))


def stop_after(out: Path, segments: int, **settings) -> int:
    from bojax.engine.runner import ChunkRunner

    original, count = ChunkRunner._segment, 0

    def segment(self):
        nonlocal count
        result = original(self)
        count += 1
        if count == segments:
            os.kill(os.getpid(), signal.SIGINT)
            while not self._limits.stop():
                time.sleep(0.001)
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChunkRunner, "_segment", segment)
        patch.setattr("bojax.engine.devices.usable_cores", lambda: 1)  # one chunk after the other
        return run_sweep_here(out, **{**OFTEN, **settings})


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"runs": 7}, "runs: 6 -> 7"),
        ({"seed": 4}, "seed: 3 -> 4"),
        ({"points": ({"scale": 1.5, "max_length": 400}, *POINTS[1:])}, "config.scale: 1.0 -> 1.5"),
        ({"points": (*POINTS[:2], {"max_length": 31})}, "points.2.config.max_length: 30 -> 31"),
        ({"lanes_per_device": 3}, "layouts.0.widths.0: 4 -> 3"),
    ],
)
def test_changed_config_is_refused(interrupted, capsys, change, named):
    before = sorted(interrupted.rglob("*"))
    capsys.readouterr()
    assert run_sweep_here(interrupted, resume=True, **change) == 2
    assert named in one_error(capsys)
    assert sorted(interrupted.rglob("*")) == before


def test_segments_and_reports_may_change(interrupted, undisturbed):
    why = {"claims": ["a"], "cause": "slip", "text": "Written after the sweep began."}
    changes = {"segment_seconds": 0.5, "checkpoint_seconds": 9.0, "report": {"explanations": [why]}}
    resumes(interrupted, undisturbed, **changes)


HALFWAY = {"points": ({"scale": 1.0}, {"scale": 2.0}), "runs": 12, "lanes_per_device": 4, "device": "cpu"}
"""Three chunks of eight runs, as only a CPU has them of so few."""


@pytest.fixture(scope="module")
def undamaged(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("undamaged") / "toy"
    assert run_sweep_here(out, **HALFWAY) == 0
    return out


@pytest.fixture(scope="module")
def halfway(tmp_path_factory) -> Path:
    """A folder with a finished chunk, one that stopped at a checkpoint, and one that has not begun."""
    out = tmp_path_factory.mktemp("halfway") / "toy"
    assert stop_after(out, segments=16, **HALFWAY) == 130
    chunks = sorted((out / WORK).glob("chunk-*-1"))
    assert [len(list(chunk.glob("checkpoint-*"))) for chunk in chunks] == [0, 1]
    assert all(list(chunk.glob("arrays/*.npz")) for chunk in chunks)
    return out


@pytest.fixture
def copy(halfway, tmp_path) -> Path:
    return Path(shutil.copytree(halfway, tmp_path / "toy"))


def replace(old: str, new: str):
    def damage(path: Path) -> None:
        text = re.sub(old, new, path.read_text(), count=1)
        assert text != path.read_text()
        path.write_text(text)

    return damage


def truncate(path: Path) -> None:
    os.truncate(path, 60)


FIRST, SECOND = "chunk-00000-*-1", "chunk-00001-*-1"
STATE = f"{SECOND}/state.json"
DAMAGES = {
    "a piece is missing": (f"{SECOND}/piece-000001-steps.parquet", Path.unlink),
    "a piece is truncated": (f"{FIRST}/piece-000000-steps.parquet", truncate),
    "a snapshot is missing": (f"{FIRST}/arrays/0-0-walk-end.npz", Path.unlink),
    "the checkpoint is missing": (f"{SECOND}/checkpoint-*", shutil.rmtree),
    "a digit of the state is changed": (STATE, replace('"advances": [0-9]+', '"advances": 9')),
    "the state is truncated": (STATE, truncate),
    "the plan is changed": ("plan.json", replace('"seed": 3', '"seed": 4')),
}
"""A bit that is flipped in any file of a chunk is tested in `test_sinks`."""


def files_of(folder: Path) -> set[Path]:
    return {path.relative_to(folder) for path in folder.rglob("*")}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_folder_is_refused_in_one_line(copy, capsys, name):
    pattern, damage = DAMAGES[name]
    path = min((copy / WORK).glob(pattern))
    damage(path)
    before = files_of(copy)
    capsys.readouterr()
    assert run_sweep_here(copy, resume=True, **HALFWAY) == 2
    line = one_error(capsys)
    damaged = path if path.parent.name == WORK else copy / WORK / path.relative_to(copy / WORK).parts[0]
    assert (
        str(damaged) in line and f"delete th{'e folder' if path.parent.name != WORK else 'is file'}" in line
    )
    assert files_of(copy) == before  # nothing is merged, and nothing deleted


def test_a_copied_chunk_is_refused(copy, capsys):
    first, second = (next((copy / WORK).glob(pattern)) for pattern in (FIRST, SECOND))
    shutil.rmtree(second)
    shutil.copytree(first, second)
    capsys.readouterr()
    assert run_sweep_here(copy, resume=True, **HALFWAY) == 2
    assert f"{second / 'state.json'}: copied from another chunk; delete the folder" in one_error(capsys)


@pytest.mark.parametrize("is_folder", [False, True])
def test_what_no_number_depends_on_may_be_damaged(copy, undamaged, is_folder):
    first, second = (next((copy / WORK).glob(pattern)) for pattern in (FIRST, SECOND))
    (compiled,) = (copy / WORK).glob("compiled-*.json")
    (done,) = (copy / WORK).glob("chunk-*.done")
    (copy / WORK / f"{second.name[:-2]}-{10**30}").mkdir()  # an attempt that nobody can count up to
    for path in (compiled, done, second / "attempt.json", copy / WORK / "launch.json"):
        path.write_text('{"launch": 7}')
        if is_folder:
            path.unlink()
            path.mkdir()
    (copy / WORK / "lock").unlink()
    (copy / ".work-done" / "chunk").mkdir(parents=True)
    (second / "piece-foo.parquet").write_text("stray")
    (second / "piece-000009-steps.parquet").mkdir()
    shutil.copy(first / "piece-000000-steps.parquet", second / "piece-000008-steps.parquet")  # not committed
    shutil.copy(first / "arrays" / "0-0-walk-end.npz", second / "arrays" / "1-9-walk-end.npz")
    (second / "checkpoint-00000099").write_text("stray")
    (second / "learners-00000099.orbax-checkpoint-tmp" / "state").mkdir(parents=True)
    resumes(copy, undamaged, **HALFWAY)
    assert not (copy / "learners").exists() and not list(copy.glob(".*"))


@pytest.mark.parametrize("pattern", [f"{SECOND}/state.json", "plan.json"])
def test_what_can_be_made_again_may_be_missing(copy, undamaged, pattern):
    min((copy / WORK).glob(pattern)).unlink()
    resumes(copy, undamaged, **HALFWAY)


def test_cut_off_while_merging(copy, undamaged, monkeypatch):
    """Tables and some of the snapshots are in place, the manifest does not say finished."""
    from bojax.results import merge

    move, count = merge._move, 0

    def moves_once(source, target):
        nonlocal count
        count += 1
        if count > 1:
            raise KeyboardInterrupt
        move(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(merge, "_move", moves_once)
        with pytest.raises(KeyboardInterrupt):
            run_sweep_here(copy, resume=True, **HALFWAY)
    assert len(list((copy / "arrays").glob("*.npz"))) == 1
    resumes(copy, undamaged, **HALFWAY)


def test_deleting_a_bad_chunk_mends_it(interrupted, undisturbed):
    checkpoint, *_ = interrupted.glob(f"{WORK}/chunk-*/checkpoint-*")
    shutil.rmtree(checkpoint.parent)
    resumes(interrupted, undisturbed)
