"""Processes that write reports."""

import subprocess
import sys
import time
from pathlib import Path

from bojax.cli.background import Reports

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
    deadline = time.monotonic() + 15
    while is_running(writer) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not is_running(writer)


def test_a_report_that_cannot_be_written_is_told_in_one_line(tmp_path, capsys):
    with Reports(in_background=True) as reports:
        reports.write(tmp_path / "nothing")
    assert reports.exit_code == 1
    message = capsys.readouterr().err.splitlines()
    assert len(message) == 1 and "nothing cannot be written" in message[0]
