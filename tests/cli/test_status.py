"""`bojax status` and `bojax worker`: what they print and refuse. Running chunks is tested in tests/engine."""

import os
import signal
import sys
import time
import types

import pyarrow as pa
import pytest
from typing_extensions import override

from bojax.cli.main import main
from bojax.engine import signals
from bojax.results.folder import RunFolder
from bojax.results.leases import Leases
from bojax.results.store import write_json

PLAN = {
    "runs": 10,
    "device": {"platform": "gpu", "kind": "H200"},
    "groups": [[0, 2], [1]],
    "layouts": [{"queue": 8}, {"queue": 8}],
}
NAMES = [f"chunk-{index:05d}-0123456789ab" for index in range(5)]
"""Two points of ten runs make chunks of 8, 8 and 4 runs, one point makes chunks of 8 and 2."""


@pytest.fixture
def folder(tmp_path):
    run_folder = RunFolder(tmp_path / "out")
    run_folder.create(None)
    run_folder.launch({"name": "parking", "engine": {"lease_seconds": 60.0}})
    run_folder.close(finished=False)
    return run_folder


def worker(folder: RunFolder, owner: str) -> Leases:
    leases = Leases(folder.work, folder.path, launch=1, seconds=60.0, owner=owner)
    leases.beat()
    return leases


def status(folder: RunFolder, capsys) -> tuple[int, list[str]]:
    code = main(["status", str(folder.path)])
    return code, capsys.readouterr().out.splitlines()


def test_before_anything_is_planned(folder, capsys):
    assert status(folder, capsys) == (0, [f"{folder.path}: parking: waiting for the first worker"])


def test_a_task_of_slurm_that_ended_before_its_worker_began(folder, capsys):
    for number, seconds in ((1, 2000.0), (2, 1000.0)):
        path = folder.work / f"slurm-{number}_0.out"
        path.write_text("module: command not found")
        os.utime(path, (seconds, seconds))
    code, (_, line) = status(folder, capsys)
    assert code == 0 and line == f"output of the last task: {folder.work}/slurm-1_0.out"


def test_chunks_of_every_kind(folder, capsys):
    folder.join(PLAN, {})
    a, b = worker(folder, "node1-7"), worker(folder, "node2-9")
    done = a.take(NAMES[0])
    done.write_part({"steps": pa.table({"x": [1]})})
    done.commit()
    a.finish(NAMES[0], {"seconds": 40.0})
    for leases, name in ((a, NAMES[1]), (b, NAMES[2]), (a, NAMES[3])):
        leases.take(name)
    a.fail(NAMES[3], "boom")
    long_ago = os.stat(folder.work).st_mtime - 200
    os.utime(folder.work / "worker-node2-9.json", (long_ago, long_ago))
    code, lines = status(folder, capsys)
    assert code == 1
    assert lines[0] == (
        f"{folder.path}: parking on H200: 1 of 5 chunks done, 8 of 30 runs, "
        "1 running, 1 lost, 1 failed, 1 waiting"
    )
    assert lines[1].startswith("running: chunk 1 (8 runs), attempt 1, node1-7, for ")
    assert lines[2].startswith("lost: chunk 2 (4 runs), attempt 1, node2-9, for ")
    assert "silent for 3 min 2" in lines[2]
    assert lines[3] == "failed: chunk 3: boom"
    assert lines[4] == "about 1 min 50 s left with 1 at a time"  # 22 runs of 5 s
    assert not list(folder.work.glob(".now*"))


def test_all_done_and_merged(folder, capsys):
    folder.join({**PLAN, "groups": [[0]], "layouts": [{"queue": 8}], "runs": 4}, {})
    a = worker(folder, "node1-7")
    a.take(NAMES[0])
    a.give_back(NAMES[0])
    assert ", 1 paused" in status(folder, capsys)[1][0]
    a.take(NAMES[0])
    a.finish(NAMES[0], {})
    _, lines = status(folder, capsys)
    assert "1 of 1 chunks done, 4 of 4 runs" in lines[0] and "--resume" in lines[1]
    write_json(folder.path / "manifest.json", {"status": "finished"})
    folder.close(finished=True)
    assert status(folder, capsys) == (0, [f"{folder.path}: finished"])


@pytest.mark.parametrize("command", ["status", "worker"])
def test_a_folder_without_a_sweep(tmp_path, capsys, command):
    code = main([command, str(tmp_path)])
    assert code == 2
    assert f"error: {tmp_path}: no unfinished sweep in this folder on " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--devices", "0,x"], "--devices: got 0,x; allowed: different indices from 0, such as 0,2"),
        (["--devices", "1,1"], "--devices: got 1,1; allowed: different indices"),
        (["--cores", "0"], "--cores: got 0; allowed: >= 1"),
        (["--share", "3/3"], "--share: got 3/3; allowed: NUMBER/COUNT"),
    ],
)
def test_mistakes_of_a_worker(tmp_path, capsys, words, message):
    assert main(["worker", str(tmp_path), *words]) == 2
    assert message in capsys.readouterr().err


def test_a_worker_that_is_asked_to_requeue_while_it_imports_does_so(tmp_path, capsys, monkeypatch):
    made, commands = [], []

    class Request(signals.StopRequest):
        @override
        def __enter__(self):
            made.append(self)
            return super().__enter__()

    class Importing(types.ModuleType):
        @override
        def __getattr__(self, name):
            if not made[-1]:
                os.kill(os.getpid(), signal.SIGUSR2)
            while not made[-1]:
                time.sleep(0.001)
            return None  # never called

    monkeypatch.setattr(signals, "StopRequest", Request)
    monkeypatch.setitem(sys.modules, "bojax.engine.worker", Importing("bojax.engine.worker"))
    monkeypatch.setattr("subprocess.run", lambda words, **_: commands.append(words))
    monkeypatch.setenv("SLURM_JOB_ID", "7")
    assert main(["worker", str(tmp_path)]) == 128 + signal.SIGUSR2
    assert commands == [["scontrol", "requeue", "7"]] and len(made) == 1
    assert capsys.readouterr().err == "stopped; other workers or --resume go on\n"
