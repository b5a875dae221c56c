"""Workers run shares of a sweep, and are lost: the bytes are those of one process that ran it alone."""

import shutil
import signal
from pathlib import Path

import pytest

from bojax.engine import batch
from bojax.engine.remote import num_shares
from bojax.engine.run import run_sweeps
from bojax.engine.targets import Request
from bojax.engine.worker import share_of
from bojax.results.attempts import AttemptRegistry
from bojax.results.folder import RunFolder
from bojax.results.store import WORK, read_manifest, read_table
from tests.engine.clusters import wait_until
from tests.engine.drive import NEEDS_CPU, contents, one_error, plan_sweep, start_worker, work_on
from tests.engine.in_process import InProcessLauncher
from tests.tiers import by_tier
from tests.toy import toy_sweep

POINTS = ({"scale": 1.0, "max_length": 80}, {"scale": 2.0, "max_length": 80}, {"max_length": 30})
SWEEP = {"points": POINTS, "runs": 8, "lanes_per_device": 2}
"""Two static groups, the first of two chunks."""

pytestmark = pytest.mark.usefixtures("kept_toys")

OFTEN = {"segment_seconds": 1e-6, "checkpoint_seconds": 0.2}


def sweep_of(**settings):
    given = {**SWEEP, **settings}
    return toy_sweep(*given.pop("points"), **given)


def run_here(out: Path, *, resume: bool = False, launcher=None, **settings) -> int:
    return run_sweeps([Request(sweep_of(**settings), out)], resume, ["bojax"], launcher=launcher)


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("alone") / "toy"
    assert run_here(out) == 0
    return contents(out)


@pytest.fixture(scope="module")
def plans(tmp_path_factory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("plans")
    plan_sweep(sweep_of(), root / "planned")
    plan_sweep(sweep_of(**OFTEN), root / "often")
    return {name: root / name for name in ("planned", "often")}


@pytest.fixture
def planned(plans, tmp_path) -> Path:
    """A folder in which nothing has run yet."""
    return Path(shutil.copytree(plans["planned"], tmp_path / "toy"))


@pytest.fixture
def often(plans, tmp_path) -> Path:
    """The same, where every advance is a segment, and checkpoints are frequent."""
    return Path(shutil.copytree(plans["often"], tmp_path / "toy"))


def attempts_of(out: Path) -> AttemptRegistry:
    return AttemptRegistry(out / WORK, out)


def merged(out: Path) -> dict[str, bytes]:
    """The results, once the driver has merged what workers have computed."""
    before = batch.compile_counts.copy()
    assert run_here(out, resume=True) == 0
    assert batch.compile_counts == before  # it has run nothing
    return contents(out)


@pytest.mark.bits
def test_a_worker_computes_and_the_driver_merges(planned, alone):
    assert work_on(planned) == 0
    assert not (planned / "runs.parquet").exists()
    assert merged(planned) == alone
    manifest = read_manifest(planned)
    assert all(group["compile_seconds"] > 0 for group in manifest["groups"])
    assert not (planned / WORK).exists()


def test_shares_are_even_and_hold_whole_groups():
    for chunks, count in ((7, 3), (8, 4), (2, 5), (0, 2)):
        shares = [share_of(list(range(chunks)), number, count) for number in range(count)]
        assert [chunk for share in shares for chunk in share] == list(range(chunks))
        assert max(map(len, shares)) - min(map(len, shares)) <= 1
    # Four shares for each worker, but none for less than a group, unless a worker would have none.
    assert [num_shares(2, groups, 70) for groups in (1, 5, 68)] == [2, 5, 8]
    assert num_shares(8, 1, 3) == 3


@NEEDS_CPU
@pytest.mark.bits
def test_shares_are_divided_anew_on_resumption(planned, alone):
    """Each worker runs its own chunks only, and a launch divides those that are left."""
    assert work_on(planned, share=(1, 3)) == 0
    (first,) = attempts_of(planned).done
    assert first.startswith("chunk-00001-")
    assert work_on(planned, share=(1, 3)) == 0  # started again: nothing is left of this share
    RunFolder(planned).launch(RunFolder(planned).launched().sweep, [0, 2])
    assert work_on(planned, share=(1, 2)) == 0
    assert [name.split("-")[1] for name in sorted(attempts_of(planned).done)] == ["00001", "00002"]
    assert work_on(planned, share=(0, 2)) == 0
    assert merged(planned) == alone


def stopping_after(segments: int):
    """A stop that is requested after a number of segments."""
    count = 0

    def stop() -> bool:
        nonlocal count
        count += 1
        return count > segments

    return stop


@pytest.mark.bits
def test_a_worker_goes_on_where_others_stopped(often, alone):
    rounds = 0
    while len(attempts_of(often).done) < 3:
        longer = 120 + 40 * rounds  # so that a device that compiles slowly also gets on
        assert work_on(often, stop=stopping_after(longer), cores=1) == 0
        rounds += 1
    assert rounds > 2
    assert merged(often) == alone


def has_checkpoint(out: Path) -> bool:
    return any((out / WORK).glob("chunk-*-1/checkpoint-*"))


@pytest.mark.bits
@pytest.mark.parametrize("number", by_tier([signal.SIGKILL, signal.SIGTERM], normal=[signal.SIGKILL]))
def test_a_driver_takes_over_from_a_worker(often, alone, number):
    worker = start_worker(often)
    wait_until(lambda: has_checkpoint(often), worker)
    worker.send_signal(number)
    worker.communicate(timeout=60)
    assert worker.returncode == (-number if number == signal.SIGKILL else 128 + number)
    assert run_here(often, resume=True) == 0
    assert contents(often) == alone


@pytest.mark.bits
def test_a_paused_worker_wakes_up_after_another_launch_has_merged_the_sweep(often, alone):
    paused = start_worker(often, "--cores", "1")
    wait_until(lambda: has_checkpoint(often), paused)
    paused.send_signal(signal.SIGSTOP)
    assert run_here(often, resume=True) == 0
    paused.send_signal(signal.SIGCONT)
    _, errors = paused.communicate(timeout=60)
    assert (paused.returncode, errors.splitlines()[-1]) == (0, "the sweep has ended")
    assert contents(often) == alone and not (often / WORK).exists()


def test_a_worker_that_differs_leaves_in_one_line(planned, capsys, monkeypatch):
    before = sorted(planned.rglob("*"))
    monkeypatch.setattr("bojax.engine.plan.device_description", lambda _: {"platform": "gpu", "kind": "H100"})
    capsys.readouterr()
    assert work_on(planned) == 2
    line = one_error(capsys)
    assert "this worker does not fit the plan" in line and "-> H100" in line
    assert line.endswith("; allowed: the same versions, on a device of the same kind")
    assert sorted(planned.rglob("*")) == before


def test_what_is_no_planned_sweep(tmp_path, planned, capsys):
    assert work_on(tmp_path / "elsewhere") == 2
    assert "elsewhere: no such folder on " in one_error(capsys)
    path = planned / WORK / "plan.json"
    path.write_text(path.read_text().replace('"seed": 3', '"seed": 4'))
    assert work_on(planned) == 2
    assert f"{path}: damaged" in one_error(capsys)


def test_a_worker_whose_disk_is_full_leaves_its_chunks_to_others(planned, alone, capsys, monkeypatch):
    from bojax.results import chunk_folder

    def full(path, table):
        raise chunk_folder.ResultsError(f"{path}: the disk is full", exit_code=1)

    with monkeypatch.context() as patch:
        patch.setattr(chunk_folder, "write_table", full)
        assert work_on(planned) == 1
    assert "the disk is full" in one_error(capsys)
    attempts = attempts_of(planned)
    assert attempts.begun() and len(attempts.paused) == len(attempts.begun()) and not attempts.failed
    assert work_on(planned) == 0
    assert merged(planned) == alone


@NEEDS_CPU
def test_a_failed_chunk_does_not_stop_the_others_and_is_told(planned, alone, capsys, monkeypatch):
    summary = batch.Programs.summary

    def fail(self, carry, lanes):
        if self.num_lanes == 2 and float(self._shared.poison) and self._shared.scale is None:
            raise RuntimeError("boom")
        return summary(self, carry, lanes)

    with monkeypatch.context() as patch:
        patch.setattr(batch.Programs, "summary", fail)
        assert work_on(planned) == 1
        assert work_on(planned) == 0  # a failure is not tried again by another worker
    attempts = attempts_of(planned)
    assert len(attempts.done) == 1 and len(attempts.failed) == 2
    assert run_here(planned, resume=True) == 0
    assert contents(planned) == alone


IN_PROCESS = InProcessLauncher(lambda folders: work_on(*folders, cores=1))


@pytest.mark.bits
@pytest.mark.parametrize("content", [None, "{}"])
def test_a_driver_that_was_lost_before_it_launched_its_workers(tmp_path, alone, content):
    out = tmp_path / "toy"
    (out / WORK).mkdir(parents=True)
    if content is not None:
        (out / WORK / "launch.json").write_text(content)
    assert run_here(out, resume=True, launcher=IN_PROCESS) == 0
    assert contents(out) == alone


@pytest.mark.bits
def test_another_sweep_is_refused_where_only_the_plan_is_left(planned, alone, capsys):
    (planned / WORK / "launch.json").write_text("{}")
    points = [
        ({"runs": 9}, "runs: 8 -> 9"),
        ({"points": POINTS[:2]}, "points: a list of 3 -> a list of 2"),
        ({}, ""),
    ]
    for changes, told in points:
        code = run_here(planned, resume=True, launcher=IN_PROCESS, **changes)
        assert (code, told in capsys.readouterr().err) == (2 if told else 0, True)
    assert contents(planned) == alone


class Late(InProcessLauncher):
    """The worker has left, and its last files are seen when the driver has looked a number of times."""

    def __init__(self, out: Path, looks: int):
        super().__init__(lambda folders: work_on(*folders, cores=1))
        self.out, self.looks_left = out, looks

    def start(self, name, folders, groups, chunks):
        super().start(name, folders, groups, chunks)
        for path in (self.out / WORK).glob("*.done"):
            path.rename(path.with_suffix(".late"))

    def keep(self):
        self.looks_left -= 1
        for path in (self.out / WORK).glob("*.late") if self.looks_left == 0 else ():
            path.rename(path.with_suffix(".done"))
        return False


@pytest.mark.parametrize(("looks", "refused", "left"), [(3, False, 0), (99, False, None), (3, True, 2)])
def test_files_that_are_seen_late(planned, alone, capsys, monkeypatch, looks, refused, left):
    """The driver waits for them once the last worker has left, unless the workers have told an error."""
    monkeypatch.setattr("bojax.engine.remote.POLL_SECONDS", 0.01)
    monkeypatch.setattr("bojax.engine.remote.LATE_SECONDS", 60.0 if left == 0 else 0.1)
    launcher = Late(planned, looks)
    launcher.all_refused = refused
    code = run_here(planned, resume=True, launcher=launcher)
    if left == 0:
        assert code == 0 and contents(planned) == alone
    else:
        assert code == 1 and "the workers have ended early; to go on: bojax" in one_error(capsys)
        assert left is None or launcher.looks_left == left


def test_several_sweeps_are_one_plan(planned, tmp_path, alone):
    other = tmp_path / "other"
    plan_sweep(sweep_of(runs=2), other)
    assert work_on(planned, other) == 0
    assert merged(planned) == alone
    assert run_here(other, resume=True, runs=2) == 0
    assert read_table(other / "runs.parquet").num_rows == 6
