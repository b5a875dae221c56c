"""Processes that write reports."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from bojax.cli.background import Reports
from tests.engine.clusters import wait_until

KILLED = """
import os, signal
from bojax.cli.background import Reports
if __name__ == "__main__":
    with Reports(in_background=True) as reports:
        print(reports._pool.submit(os.getpid).result(), flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""


def is_running(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:  # it has ended
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"  # a zombie has ended too, but nobody has waited for it


def test_the_processes_end_if_the_main_process_is_killed(tmp_path):
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    killed = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert killed.returncode == -9
    writer = int(killed.stdout)
    wait_until(lambda: not is_running(writer), seconds=15)


CALLER = """
import bojax
env = {"kind": "patient:Patient", "length": 4, "sparsity": 1, "start": 0, "max_length": 4, "max_steps": 40}
bojax.run({"experiment": "learning", "env": env, "learner": "additive", "episodes": 2}, out="cut")
"""

PATIENT = """
import os, time
from pathlib import Path
from bojax.envs.chain import Chain
from bojax.report import progress

class Patient(Chain):
    pass

def report(folder):
    Path("writer.tmp").write_text(str(os.getpid()))
    Path("writer.tmp").rename("writer")
    time.sleep(600)

progress.report = report
"""


@pytest.mark.slow
def test_a_sweep_from_python_ends_if_the_caller_is_killed_while_the_report_is_written(tmp_path):
    (tmp_path / "patient.py").write_text(PATIENT)
    writer = tmp_path / "writer"
    with subprocess.Popen([sys.executable, "-c", CALLER], cwd=tmp_path) as caller:
        try:
            wait_until(lambda: writer.exists() or caller.poll() is not None, seconds=120)
        finally:
            caller.kill()
    wait_until(lambda: not is_running(int(writer.read_text())), seconds=15)


def test_a_report_that_cannot_be_written_is_told_in_one_line(tmp_path, capsys):
    with Reports(in_background=True) as reports:
        reports.write(tmp_path / "nothing")
    assert reports.exit_code == 1
    lines = capsys.readouterr().err.splitlines()
    (message,) = [line for line in lines if not line.startswith("waited ")]
    assert "nothing cannot be written" in message


def test_a_signal_to_all_processes_breaks_no_report():
    """`timeout` sends SIGTERM to the whole group, and the main process alone decides."""
    with Reports(in_background=True) as reports:
        pool: Any = reports._pool
        process = pool.submit(os.getpid).result()
        later = pool.submit(time.sleep, 0.3)
        os.kill(process, signal.SIGTERM)
        assert later.result() is None and pool.submit(os.getpid).result() == process


@pytest.fixture
def blocks_signal():
    """Makes another thread receive Ctrl-C, as the kernel may choose."""
    yield lambda: signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@pytest.mark.parametrize("is_waiting", [False, True])
def test_after_a_signal_reports_are_given_up(tmp_path, capsys, is_waiting, blocks_signal):
    names = ("first", "second") if is_waiting else ("first",)
    with Reports(in_background=True) as reports:
        pool: Any = reports._pool
        reports._pending |= {tmp_path / name: pool.submit(time.sleep, 600) for name in names}
        if is_waiting:
            threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
            blocks_signal()
        else:
            reports.stop()
    assert reports.exit_code == (130 if is_waiting else 0)
    what = "2 reports are not written; to write them"
    what = what if is_waiting else "the report is not written; to write it"
    folders = " ".join(str(tmp_path / name) for name in names)
    assert f"interrupted; {what}: bojax report {folders}" in capsys.readouterr().err.splitlines()
