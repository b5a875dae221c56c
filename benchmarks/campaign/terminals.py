"""Terminals that close and pipes that break: a stop at a checkpoint, or a finished sweep with its report."""

import contextlib
import os
import pty
import random
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.campaign.case import Outcome
from benchmarks.campaign.process import scratch
from benchmarks.campaign.workloads import ROOT, WORKLOADS, duration, fault_in, resumed

_WORKLOADS = ("tabular", "tabular", "planning")
_PIPES = ("| head -1", "| true", "2>&1 | head -1", ">&-", "2>&-", ">&- 2>&- <&-", "2> /dev/full")


def check(seed: int) -> Outcome:
    """Close the terminal of a sweep, or break the pipe that it writes to."""
    draw = random.Random(f"terminals {seed}")
    return _close(draw) if draw.random() < 0.6 else _break(draw)


def _close(draw: random.Random) -> Outcome:
    name = draw.choice(_WORKLOADS)
    # The process starts for a second or two.
    workload, delay = WORKLOADS[name], draw.uniform(0.0, 2.0 + duration(name))
    is_ignored = draw.random() < 0.25
    tried = f"{name}, terminal closed after {delay:.2f} s" + ", signal ignored as by nohup" * is_ignored
    with scratch() as place:
        out = place / "out"
        child, terminal = pty.fork()
        if child == 0:
            with contextlib.suppress(BaseException):
                os.chdir(place)
                signal.signal(signal.SIGHUP, signal.SIG_IGN if is_ignored else signal.SIG_DFL)
                workload.start_afresh(out)()
            os._exit(1)
        time.sleep(delay)
        os.close(terminal)
        late = time.monotonic() + 90.0
        while not (ended := os.waitpid(child, os.WNOHANG))[0]:
            if time.monotonic() > late:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return Outcome(tried, "not over after 90 s")
            time.sleep(0.01)
        code = os.waitstatus_to_exitcode(ended[1])
        # Before bojax handles the signal, it ends the process.
        if code not in ((0,) if is_ignored else (0, 129, -signal.SIGHUP)):
            return Outcome(tried, f"exit code {code}")
        return Outcome(tried, resumed(name, out, place) if code else fault_in(out, name))


def _break(draw: random.Random) -> Outcome:
    how = draw.choice(_PIPES)
    words = [sys.executable, "-m", "bojax", *WORKLOADS["tabular"].words, "--out", "out"]
    line = f"{shlex.join(words)} {how}; exit ${{PIPESTATUS[0]}}"
    with scratch() as place:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            ["bash", "-c", line],
            cwd=place,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=180,
        )
        return Outcome(f"bojax run ... {how}", _fault(done.returncode, place / "out"))


def _fault(code: int, out: Path) -> str:
    if code:
        return f"exit code {code}"
    if not (out / "report.html").is_file():
        return "no report"
    return fault_in(out, "tabular")
