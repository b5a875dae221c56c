"""`bojax status` and `bojax worker`: what they print and refuse. Running chunks is tested in tests/engine."""

import json
import os
import signal
import socket
import sys
import time
import types

import pyarrow as pa
import pytest
from typing_extensions import override

from bojax.cli.main import main
from bojax.engine import signals
from bojax.results.attempts import AttemptRegistry
from bojax.results.folder import RunFolder
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
    run_folder.launch({"name": "parking", "engine": {"checkpoint_seconds": 60.0}})
    run_folder.close(finished=False)
    return run_folder


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
    attempts = AttemptRegistry(folder.work, folder.path)
    done, running, silent, failed, gone = (attempts.begin(name, "launch") for name in NAMES)
    done.write_piece({"steps": pa.table({"x": [1]})})
    done.commit()
    attempts.end(done, "done", {"seconds": 40.0})
    attempts.end(failed, "failed", {"error": "boom"})
    long_ago = os.stat(folder.work).st_mtime - 400
    record = json.loads((gone.path / "attempt.json").read_text())
    process = record["process"]
    (gone.path / "attempt.json").write_text(json.dumps({**record, "process": [*process[:3], "0"]}))
    elsewhere = json.dumps({**record, "process": ["another boot", *process[1:]]})
    (silent.path / "attempt.json").write_text(elsewhere)
    for each in (silent, running):  # a process of this machine that runs is not lost, however long it takes
        for path in (each.path / "attempt.json", each.path):
            os.utime(path, (long_ago, long_ago))
    code, lines = status(folder, capsys)
    assert code == 1
    assert lines[0] == (
        f"{folder.path}: parking on H200: 1 of 5 chunks done, 8 of 30 runs, 1 running, 2 lost, 1 failed"
    )
    me = f"{socket.gethostname()}-{os.getpid()}"
    assert lines[1].startswith(f"running: chunk 1 (8 runs), attempt 1, {me}, for ")
    assert lines[1].endswith(" ago")
    assert lines[2].startswith("lost: chunk 2 (4 runs), attempt 1, ")
    assert "last wrote 6 min 4" in lines[2]
    assert lines[3].startswith("lost: chunk 4 (2 runs), ") and lines[3].endswith(", its process is gone")
    assert lines[4] == "failed: chunk 3: boom"
    assert lines[5] == "about 1 min 50 s left with 1 at a time"  # 22 runs of 5 s
    assert not list(folder.work.glob(".now*"))


def test_all_done_and_merged(folder, capsys):
    folder.join({**PLAN, "groups": [[0]], "layouts": [{"queue": 8}], "runs": 4}, {})
    attempts = AttemptRegistry(folder.work, folder.path)
    attempts.end(attempts.begin(NAMES[0], "launch"), "paused", {})
    assert ", 1 paused" in status(folder, capsys)[1][0]
    attempts.end(attempts.begin(NAMES[0], "launch"), "done", {})
    _, lines = status(folder, capsys)
    assert "1 of 1 chunks done, 4 of 4 runs" in lines[0] and "--resume" in lines[1]
    write_json(folder.path / "manifest.json", {"status": "finished"})
    folder.close(finished=True)
    assert status(folder, capsys) == (0, [f"{folder.path}: finished"])


def test_mistakes(tmp_path, refusal):
    missing = f"{tmp_path}: no unfinished sweep in this folder on "
    for command, words, message in (
        ("status", "", missing),
        ("worker", "", missing),
        ("worker", "--devices 0,x", "--devices: got 0,x; allowed: different indices from 0, such as 0,2"),
        ("worker", "--devices 1,1", "--devices: got 1,1; allowed: different indices"),
        ("worker", "--cores 0", "--cores: got 0; allowed: >= 1"),
        ("worker", "--share 3/3", "--share: got 3/3; allowed: NUMBER/COUNT"),
    ):
        assert refusal(f"{command} {tmp_path} {words}").startswith(message)


def test_a_worker_that_is_told_of_its_time_limit_while_it_imports_stops(tmp_path, capsys, monkeypatch):
    made = []

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
    assert main(["worker", str(tmp_path)]) == 128 + signal.SIGUSR2
    assert len(made) == 1 and capsys.readouterr().err.startswith("stopped at a checkpoint; ")
