"""A whole sweep: its results folder, and its failures."""

import errno
import os
import signal
import threading
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import jax
import numpy as np
import pytest

from bojax.config.claims import Claim
from bojax.config.files import display
from bojax.config.limits import Limit
from bojax.engine import batch, chunks, compiler, execute, program_cache, tasks
from bojax.engine.chunks import Layout
from bojax.engine.devices import new_lock
from bojax.engine.run import run_sweeps
from bojax.engine.runner import ChunkRunner
from bojax.engine.scheduler import Scheduler
from bojax.engine.targets import Request, choose_targets
from bojax.results.attempts import AttemptRegistry
from bojax.results.folder import RunFolder
from bojax.results.store import WORK, ResultsError, read_manifest, read_table
from tests.engine.drive import NEEDS_CPU, contents, one_error, run_sweep, run_toy, start_toy
from tests.tiers import by_tier
from tests.toy import Toy, toy_sweep

RUNS = 10

pytestmark = pytest.mark.usefixtures("kept_toys")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("sweep") / "toy"
    before = batch.compile_counts.copy()
    assert run_toy(out, runs=RUNS) == 0
    # Two static groups: the points that differ in a number share one.
    names = "empty", "fill", "advance", "summary", "snapshot"
    each = {name: 2 for name in names}
    assert batch.compile_counts - before == each
    return out


def columns(path: Path) -> dict[str, np.ndarray]:
    table = read_table(path)
    return {name: table[name].to_numpy() for name in table.column_names}


def test_runs(folder):
    runs = read_table(folder / "runs.parquet")
    assert runs.column_names == [
        *("point", "label", "variant", "scale", "max_length", "run", "seed"),
        *("return", "steps", "first_right", "success", "nans"),
    ]
    assert runs["point"].to_pylist() == [point for point in range(3) for _ in range(RUNS)]
    assert runs["run"].to_pylist() == list(range(RUNS)) * 3
    assert set(runs["variant"].to_pylist()) == {"scale=1.0", "scale=2.0", "max_length=15"}
    assert runs["scale"].to_pylist() == [1.0] * RUNS + [2.0] * RUNS + [None] * RUNS
    assert runs["nans"].to_pylist() == [0] * 3 * RUNS
    assert runs["first_right"].null_count > 0 and -1 not in runs["first_right"].to_pylist()
    assert runs.schema.field("return").metadata == {b"unit": b"m"}


def test_steps_stop_where_the_run_does(folder):
    runs, steps = columns(folder / "runs.parquet"), columns(folder / "steps.parquet")
    expected = [
        (point, run, step)
        for point, run, length in zip(runs["point"], runs["run"], runs["steps"], strict=True)
        for step in range(1, length + 1)
    ]
    assert list(zip(steps["point"], steps["run"], steps["step"], strict=True)) == expected


def test_arrays_of_the_recorded_runs(folder):
    names = sorted(path.name for path in (folder / "arrays").iterdir())
    assert names == sorted(f"{point}-{run}-walk-end.npz" for point in range(3) for run in range(2))
    steps = columns(folder / "steps.parquet")
    last = np.nonzero((steps["point"] == 1) & (steps["run"] == 1))[0][-1]
    with np.load(folder / "arrays" / "1-1-walk-end.npz") as arrays:
        assert arrays["position"].tolist() == [steps["x"][last], steps["y"][last]]
        assert arrays["start"].tolist() == [0.0, 1.0]


def test_the_manifest_has_the_checksums_of_tables_and_arrays(folder):
    files = [*folder.glob("*.parquet"), *folder.glob("arrays/*")]
    found = {path.relative_to(folder).as_posix(): sha256(path.read_bytes()).hexdigest() for path in files}
    assert read_manifest(folder)["sha256"] == found and len(found) == 9


def test_manifest(folder):
    manifest = read_manifest(folder)
    assert manifest["status"] == "finished" and manifest["command"] == "bojax sweep toy"
    assert [group["points"] for group in manifest["groups"]] == [[0, 1], [2]]
    assert all(manifest["times"][stage] >= 0 for stage in ("planning", "merging"))
    runs = columns(folder / "runs.parquet")
    timings = columns(folder / "timings.parquet")
    for index, group in enumerate(manifest["groups"]):
        assert group["active_steps"] == np.sum(runs["steps"][np.isin(runs["point"], group["points"])])
        assert group["run_seconds"] == sum(timings["seconds"][timings["group"] == index]) > 0
        assert group["compile_seconds"] > 0
        times = [group["times"][name] for name in ("compiling", "compiled", "begun", "ended")]
        assert 0 <= times[0] and times == sorted(times)
    assert all(chunk["status"] == "done" for chunk in manifest["chunks"])
    assert manifest["device"]["platform"] == jax.default_backend() and manifest["precision"]["x64"]
    assert not (folder / WORK).exists()


def test_timings(folder):
    timings = read_table(folder / "timings.parquet")
    chunks = read_manifest(folder)["chunks"]
    assert timings["point"].to_pylist() == [chunk["point"] for chunk in chunks]
    assert timings["lanes"].to_pylist() == [chunk["runs"] for chunk in chunks]
    assert all(seconds > 0 for seconds in timings["seconds"].to_pylist())


def test_chunks_and_segments_change_nothing(folder, tmp_path):
    out = tmp_path / "toy"
    assert run_toy(out, runs=RUNS, lanes_per_device=5, segment_seconds=1e-6) == 0
    assert len(read_table(out / "timings.parquet")) > 6
    assert contents(out) == contents(folder)


@NEEDS_CPU
@pytest.mark.bits
def test_any_number_of_devices_gives_the_same_bytes(folder, tmp_path, monkeypatch):
    """XLA divides the CPU into two devices, of which each runs a chunk at least."""
    begun, runner = {device: threading.Event() for device in jax.devices("cpu")}, execute._Executor._runner

    def begins(executor, task, chunk, sink, device):
        begun[device].set()
        assert all(event.wait(60.0) for event in begun.values())
        return runner(executor, task, chunk, sink, device)

    monkeypatch.setattr(execute._Executor, "_runner", begins)
    assert len(begun) == 2 and run_toy(tmp_path / "toy", runs=RUNS, devices=[0, 1]) == 0
    assert read_manifest(tmp_path / "toy")["device"]["count"] == 2
    assert contents(tmp_path / "toy") == contents(folder)


class Accelerator:
    """A device that is taken for a GPU."""

    platform = device_kind = "gpu"

    def __init__(self, real):
        self.real, self.client = real, real.client


@NEEDS_CPU
def test_a_sweep_that_was_begun_on_the_cpu_stays_there_beside_a_gpu(folder, tmp_path, monkeypatch):
    """Two sweeps in one go, each on the platform that it was begun on."""
    used = []

    class OnReal(batch.Programs):
        def __init__(self, functions, device, *others, **options):
            used.append((functions.group.shared.max_length, device.platform))
            super().__init__(functions, getattr(device, "real", device), *others, **options)

    cpu, other = jax.devices("cpu")
    gpu = Accelerator(other)
    monkeypatch.setattr(tasks, "Programs", OnReal)
    sweeps = {"short": toy_sweep({"max_length": 15}, runs=RUNS), "usual": toy_sweep(runs=RUNS)}
    requests = {name: Request(sweep, tmp_path / name) for name, sweep in sweeps.items()}
    with monkeypatch.context() as patch:  # both stop before their first chunk
        patch.setattr("bojax.engine.run.execute", lambda *_: iter(()))
        for name, devices in (("short", [cpu]), ("usual", [gpu, cpu])):
            patch.setattr("bojax.engine.run.find_devices", lambda _, devices=devices: devices)
            run_sweeps([requests[name]], False, ["bojax"])
    monkeypatch.setattr("bojax.engine.run.find_devices", lambda _: [gpu, cpu])
    assert run_sweeps(list(requests.values()), True, ["bojax"]) == 0
    devices = {name: read_manifest(tmp_path / name)["device"] for name in requests}
    assert {name: (each["platform"], each["count"]) for name, each in devices.items()} == {
        "short": ("cpu", 1),
        "usual": ("gpu", 1),
    }
    assert set(used) == {(15, "cpu"), (15, "gpu"), (12, "gpu")}
    assert contents(tmp_path / "usual") == contents(folder)


@NEEDS_CPU
@pytest.mark.bits
def test_workers_of_an_accelerator_advance_one_chunk_at_a_time(folder, tmp_path, monkeypatch):
    begun, ended = [], []
    next_begins = [threading.Event() for _ in range(3)]
    original = {name: getattr(ChunkRunner, name) for name in ("advance", "finish")}

    def advance(runner):
        assert len(begun) == len(ended)
        begun.append(runner)
        for event in next_begins[: len(begun) - 1]:
            event.set()
        original["advance"](runner)
        ended.append(runner)

    def finish(runner):
        number = begun.index(runner)
        assert number == 2 or next_begins[number].wait(60.0)  # the other worker goes on with the next chunk
        original["finish"](runner)

    monkeypatch.setattr(execute, "new_lock", lambda device: new_lock(Accelerator(device)))
    monkeypatch.setattr("bojax.engine.tasks.workers_of", lambda devices, _: [devices[0]] * 2)
    monkeypatch.setattr(ChunkRunner, "advance", advance)
    monkeypatch.setattr(ChunkRunner, "finish", finish)
    assert run_toy(tmp_path / "toy", runs=RUNS) == 0
    assert len(ended) == 3
    assert contents(tmp_path / "toy") == contents(folder)


def test_a_chunk_that_waits_for_a_program_lets_the_other_worker_go_on(tmp_path, monkeypatch):
    waits, has_gone_on = threading.Event(), threading.Event()
    narrow, finish = ChunkRunner._narrow, ChunkRunner.finish

    class Late(batch.Programs):
        def __init__(self, functions, device, num_lanes, *others, **options):
            first_group, lanes = functions.group.index == 0, num_lanes
            if (first_group, lanes) == (False, 4):
                assert waits.wait(60.0)
            if (first_group, lanes) == (True, 2):
                assert has_gone_on.wait(60.0)
            super().__init__(functions, device, num_lanes, *others, **options)

    def noted_narrow(runner, *arguments):
        waits.set()
        narrow(runner, *arguments)

    def noted_finish(runner):
        finish(runner)
        if runner._chunk.group == 1:
            has_gone_on.set()

    monkeypatch.setattr(tasks, "Programs", Late)
    monkeypatch.setattr(compiler, "compile_threads", lambda: 3)
    monkeypatch.setattr(execute, "new_lock", lambda device: new_lock(Accelerator(device)))
    monkeypatch.setattr("bojax.engine.tasks.workers_of", lambda devices, _: [devices[0]] * 2)
    monkeypatch.setattr("bojax.engine.plan.choose_layout", lambda *_: Layout(4, (4, 2), 1))
    monkeypatch.setattr(ChunkRunner, "_narrow", noted_narrow)
    monkeypatch.setattr(ChunkRunner, "finish", noted_finish)
    assert run_toy(tmp_path / "toy", {"max_length": 20}, {"max_length": 10}, runs=4) == 0
    assert waits.is_set()


def test_nans_are_counted(tmp_path, capsys):
    out = tmp_path / "toy"
    assert run_toy(out, {"poison": 1.0}, {"poison": 2.0}, runs=RUNS) == 0
    runs, steps = columns(out / "runs.parquet"), columns(out / "steps.parquet")
    expected = np.isnan(runs["return"]).astype(int)
    for point, run, x, y in zip(*(steps[name] for name in ("point", "run", "x", "y")), strict=True):
        expected[RUNS * point + run] += int(np.isnan(x)) + int(np.isnan(y))
    assert runs["nans"].tolist() == expected.tolist() and expected.sum() > 0
    by_point = {str(point): int(expected[runs["point"] == point].sum()) for point in (0, 1)}
    assert read_manifest(out)["nans"] == {point: count for point, count in by_point.items() if count}
    assert f"warning: {(expected > 0).sum()} runs with NaN" in capsys.readouterr().err


def test_no_gpu(tmp_path, capsys, monkeypatch):
    find = jax.devices

    def without_gpu(platform=None):
        if platform == "gpu":
            raise RuntimeError("Unknown backend: 'gpu' requested, but no platforms that are instances of it")
        return find(platform)

    monkeypatch.setattr(jax, "devices", without_gpu)
    assert run_toy(tmp_path / "toy", device="gpu") == 2
    line = one_error(capsys)
    assert "engine.device: got gpu" in line and "engine.device=auto" in line
    assert not (tmp_path / "toy").exists()


def test_full_disk_is_resumable(tmp_path, capsys, folder, monkeypatch):
    out = tmp_path / "toy"
    replace, count = os.replace, 0

    def full(source, target):
        nonlocal count
        count += Path(target).suffix == ".parquet"
        if count > 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        assert run_toy(out, runs=RUNS) == 1
    line = one_error(capsys)
    assert "the disk is full" in line and "--resume" in line
    assert not list(out.rglob("*.tmp")) and not (out / "runs.parquet").exists()
    assert run_toy(out, runs=RUNS, resume=True) == 0
    assert contents(out) == contents(folder)


def test_full_disk_at_a_checkpoint(tmp_path, capsys, monkeypatch):
    def full(*_, **__):
        raise ValueError("RESOURCE_EXHAUSTED: No space left on device [os_error_code='28']")

    monkeypatch.setattr("orbax.checkpoint.v1.save_async", full)
    often = {"segment_seconds": 1e-6, "checkpoint_seconds": 1e-6}
    assert run_toy(tmp_path / "toy", {"max_length": 200}, **often) == 1
    line = one_error(capsys)
    assert "the disk is full" in line


def test_out_of_memory_names_the_setting(tmp_path, capsys, monkeypatch):
    def exhausted(self, *_):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 99 bytes.")

    monkeypatch.setattr(batch.Programs, "advance", exhausted)
    assert run_toy(tmp_path / "toy", {"scale": 1.0}, runs=64, lanes_per_device=16) == 1
    line = one_error(capsys)
    assert "16 lanes per device: try engine.lanes_per_device=8" in line


def test_a_failed_chunk_does_not_stop_the_others(tmp_path, capsys, folder, monkeypatch):
    out = tmp_path / "toy"
    monkeypatch.setattr(chunks, "QUEUE_ON_ACCELERATOR", RUNS)  # a chunk for each point, as on a CPU
    place = batch.Programs.place

    def fail(self, positions, runs):
        if runs[0] == 0 and positions[0] == 1:
            raise RuntimeError("boom\nand a stack")
        return place(self, positions, runs)

    with monkeypatch.context() as patch:
        patch.setattr(batch.Programs, "place", fail)
        assert run_toy(out, runs=RUNS, lanes_per_device=10) == 1
    line = one_error(capsys)
    assert "1 of 3 chunks failed: RuntimeError: boom and a stack (traceback in " in line
    manifest = read_manifest(out)
    assert manifest["status"] == "failed"
    assert [chunk["status"] for chunk in manifest["chunks"]] == ["done", "failed", "done"]
    (stack,) = out.glob(f"{WORK}/error-*.txt")
    assert manifest["chunks"][1]["error"] == f"RuntimeError: boom and a stack (traceback in {stack})"
    assert "and a stack" in stack.read_text()
    assert set(read_table(out / "runs.parquet")["point"].to_pylist()) == {0, 2}
    assert run_toy(out, runs=RUNS, lanes_per_device=10, resume=True) == 0
    assert contents(out) == contents(folder)
    assert read_manifest(out)["status"] == "finished"


def test_a_group_that_cannot_be_compiled_does_not_stop_the_others(tmp_path, capsys, monkeypatch):
    class Uncompilable(batch.Programs):
        def __init__(self, functions, *others, **options):
            if functions.group.shared.max_length == 15:
                raise RuntimeError("XLA has a bug")
            super().__init__(functions, *others, **options)

    with monkeypatch.context() as patch:
        patch.setattr(tasks, "Programs", Uncompilable)
        assert run_toy(tmp_path / "toy", runs=RUNS) == 1
    line = one_error(capsys)
    assert "RuntimeError: XLA has a bug" in line
    assert set(read_table(tmp_path / "toy" / "runs.parquet")["point"].to_pylist()) == {0, 1}
    assert run_toy(tmp_path / "toy", runs=RUNS, resume=True) == 0


def run_two(tmp_path, *, resume=False, finish=lambda _: None) -> int:
    first, second = toy_sweep({"scale": 1.0}, name="first"), toy_sweep({"scale": 3.0}, name="second")
    requests = [Request(first, tmp_path / "first"), Request(second, tmp_path / "second")]
    return run_sweeps(requests, resume, ["bojax", "sweep", "first", "second"], finish)


@pytest.mark.bits
def test_several_sweeps_are_one_plan_and_give_what_each_gives_alone(tmp_path):
    finished = []
    assert run_two(tmp_path, finish=finished.append) == 0
    assert sorted(path.name for path in finished) == ["first", "second"]
    for name, scale in (("first", 1.0), ("second", 3.0)):
        assert run_toy(tmp_path / "alone" / name, {"scale": scale}) == 0
        assert contents(tmp_path / name) == contents(tmp_path / "alone" / name)


def test_an_unexpected_error_does_not_wait_for_the_programs_of_the_other_groups(tmp_path, monkeypatch):
    has_left, begun, was_waited_for = threading.Event(), [], []

    class Late(batch.Programs):
        def __init__(self, *arguments, **options):
            begun.append(None)
            if len(begun) == 2:
                was_waited_for.extend([] if has_left.wait(20.0) else [True])
                raise RuntimeError("nobody waits any more")
            super().__init__(*arguments, **options)

    monkeypatch.setattr(tasks, "Programs", Late)
    monkeypatch.setattr(compiler, "compile_threads", lambda: 1)
    with pytest.raises(ZeroDivisionError):
        run_two(tmp_path, finish=lambda _: 1 // 0)
    assert not was_waited_for
    has_left.set()


def test_an_error_of_a_worker_thread_is_not_taken_for_the_end(tmp_path, monkeypatch):
    def fail(self, task):
        raise RuntimeError("a bug")

    monkeypatch.setattr(Scheduler, "release", fail)
    with pytest.raises(RuntimeError, match="a bug"):
        run_toy(tmp_path / "toy", {"scale": 1.0}, runs=2)


def test_a_failed_sweep_does_not_stop_the_others_and_is_tried_again(tmp_path, capsys, monkeypatch):
    finished = []
    with monkeypatch.context() as patch:
        patch.setattr(batch.Programs, "summary", fail_for_scale(3.0))
        assert run_two(tmp_path, finish=finished.append) == 1
    assert [path.name for path in finished] == ["first"]
    assert "RuntimeError: boom" in capsys.readouterr().err
    assert [read_manifest(tmp_path / name)["status"] for name in ("first", "second")] == [
        "finished",
        "failed",
    ]
    assert run_two(tmp_path, resume=True, finish=finished.append) == 0
    assert [path.name for path in finished] == ["first", "first", "second"]
    assert f"{tmp_path / 'first'}: already finished" in capsys.readouterr().out


def test_several_sweeps_on_different_devices_are_refused(tmp_path, capsys):
    first, second = toy_sweep(name="first"), toy_sweep(name="second", device="cpu")
    requests = [Request(first, tmp_path / "first"), Request(second, tmp_path / "second")]
    assert run_sweeps(requests, False, []) == 2
    message = "error: engine.device: got auto (first), cpu (second); allowed: one device for all sweeps"
    assert one_error(capsys) == message
    assert not list(tmp_path.iterdir())


def test_finished_sweeps_among_those_to_resume_are_left_out(here, monkeypatch, capsys):
    sweeps = [toy_sweep({"scale": 1.0}, name="first"), toy_sweep({"scale": 3.0}, name="second")]
    requests = [Request(sweep, None) for sweep in sweeps]
    with monkeypatch.context() as patch:
        patch.setattr(batch.Programs, "summary", fail_for_scale(3.0))
        assert run_sweeps(requests, False, []) == 1
    capsys.readouterr()
    assert run_sweeps(requests, True, []) == 0
    captured = capsys.readouterr()
    assert "note: results/first: no unfinished sweep to resume" in captured.err
    assert Path(captured.out.strip()).parent == Path("results/second")
    assert run_sweeps(requests, True, []) == 2


def test_new_folders_begin_and_a_note_says_that_nothing_is_resumed(tmp_path, capsys):
    RunFolder(tmp_path / "begun").create({})
    begun, first, second = (Request(toy_sweep(), tmp_path / name) for name in ("begun", "first", "second"))
    note = f"note: nothing to resume; starting anew: {tmp_path / 'first'}"
    for requests, resume, expected in [
        ([first], True, f"{note}\n"),
        ([first, second], True, f"{note} and 1 more\n"),
        ([begun, first], True, ""),
        ([first], False, ""),
    ]:
        targets = choose_targets(requests, resume=resume)
        assert [target.is_resumed for target in targets] == [each is begun for each in requests]
        assert capsys.readouterr().err == expected


@pytest.mark.usefixtures("compiles_anew")
@pytest.mark.parametrize("moment", ["begin", "end", "fail"])
def test_a_full_disk_stops_the_sweep(tmp_path, capsys, monkeypatch, moment):
    def full(*_):
        raise ResultsError("the disk is full", exit_code=1)

    points = {"scale": 1.0}, {"scale": 2.0}  # a chunk each
    with monkeypatch.context() as patch:
        if moment == "fail":
            patch.setattr(program_cache, "compiled", lambda *_: 1 / 0)
        patch.setattr(AttemptRegistry, "end" if moment == "fail" else moment, full)
        assert run_toy(tmp_path / "toy", *points) == 1
    assert one_error(capsys) == "error: the disk is full"
    assert all(chunk["status"] != "failed" for chunk in read_manifest(tmp_path / "toy")["chunks"])
    assert run_toy(tmp_path / "toy", *points, resume=True) == 0


def fail_for_scale(scale):
    summary = batch.Programs.summary

    def fail(self, carry, lanes):
        if float(self._shared.scale) == scale:
            raise RuntimeError("boom")
        return summary(self, carry, lanes)

    return fail


@pytest.mark.parametrize("number", by_tier([signal.SIGINT, signal.SIGTERM], normal=[signal.SIGINT]))
def test_a_signal_during_compilation_is_answered_at_once(tmp_path, number):
    slow = (
        "import time; from bojax.engine import program_cache; compile = program_cache.compiled; "
        "program_cache.compiled = lambda *a: (time.sleep(600), compile(*a))[1]"
    )
    process = start_toy(tmp_path / "toy", slow)
    for line in process.stderr:
        if line.startswith("compiling"):
            break
    process.send_signal(number)
    _, errors = process.communicate(timeout=120)  # less than the compilation would take
    assert process.returncode == 128 + number
    assert f"bojax sweep toy --out {tmp_path / 'toy'} --resume" in errors


def test_an_experiment_that_does_not_end(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(Toy, "max_advances", property(lambda self: 3))
    out = tmp_path / "toy"
    assert run_toy(out) == 1
    assert "runs are not done after 3 advances" in read_manifest(out)["chunks"][0]["error"]
    assert "runs are not done after 3 advances" in capsys.readouterr().err


def test_finished_sweep_resumed(folder, capsys):
    before = contents(folder)
    assert run_toy(folder, runs=RUNS, resume=True) == 0
    assert "already finished" in capsys.readouterr().out
    assert run_toy(folder, runs=RUNS + 1, resume=True) == 2
    assert contents(folder) == before


@pytest.mark.parametrize("key", ["rank_by", "column"])
def test_a_column_that_no_run_has_is_refused_before_anything_is_written(tmp_path, capsys, key):
    sweep = toy_sweep(runs=2)
    wrong = replace(sweep, report={**sweep.report, key: "-returns"})
    assert run_sweep(wrong, tmp_path / "toy") == 2
    message = one_error(capsys)
    assert message.startswith(
        f'error: {display(Path("toy.yaml"))}: report.{key}: got "returns"; unknown column of runs.parquet; '
    )
    assert message.endswith('did you mean "return"?') and not (tmp_path / "toy").exists()


@pytest.mark.parametrize(
    ("test", "message"),
    [
        (
            {"kind": "mean", "column": "retrun", "above": 0},
            'column: got "retrun"; unknown column of runs.parquet',
        ),
        (
            {"kind": "mean", "column": "return", "above": 0, "also": ["seed"]},
            'also.0: got "seed"; unknown column of runs',
        ),
        (
            {"kind": "mean", "column": "return", "step": 2, "above": 0},
            'column: got "return"; unknown column of steps',
        ),
        (
            {"kind": "trend", "column": "return", "from": 1, "to": 2, "direction": "rises"},
            'column: got "return"; unknown column of steps.parquet; allowed: step, x, y',
        ),
        (
            {"kind": "share", "column": "success", "window": {"from": 1, "to": 2}, "above": 0.5},
            'column: got "success"; unknown column of episodes',
        ),
    ],
)
def test_a_column_of_a_claim_that_no_table_has_is_refused_before_anything_is_written(
    tmp_path, capsys, test, message
):
    claims = [
        Claim.model_validate({"id": id, "source": "s", "claim": "c", "test": {"label": "toy", **each}})
        for id, each in (("a", {"kind": "mean", "column": "nans", "below": 1}), ("b", test))
    ]
    assert run_sweep(replace(toy_sweep(runs=2), claims=(*claims,)), tmp_path / "toy") == 2
    assert f": claims.b.test.{message}" in one_error(capsys)
    assert not (tmp_path / "toy").exists()


def test_points_with_the_same_settings_are_told(tmp_path, capsys):
    points = [{"scale": 1.0}, {"scale": 2.0}, {"scale": 1.0, "max_length": 12}]
    assert run_sweep(toy_sweep(*points, runs=2), tmp_path / "toy") == 0
    told = "note: points with the same settings have equal runs: scale 1.0; scale 1.0, max_length 12\n"
    assert capsys.readouterr().err.count(told) == 1


def test_more_chunks_than_memory_holds_are_refused_before_anything_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("bojax.engine.plan.CHUNKS", Limit("chunks", 2**60, at_least=1))
    assert run_toy(tmp_path / "toy", runs=6, lanes_per_device=2) == 2
    message = one_error(capsys)
    assert (
        message.startswith("error: engine.lanes_per_device: got ") and " chunks, which take about " in message
    )
    assert not (tmp_path / "toy").exists()
