"""What tests with Ray and with Slurm share: a sweep of four chunks, and the processes that run it."""

import contextlib
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from bojax.results.attempts import AttemptRegistry, is_gone
from bojax.results.store import WORK

SWEEP = """\
base: cliff-walking
axes: {env.slip: [0.01, 0.1, 0.2]}
runs: 20
record: {runs: 0}
engine: {segment_seconds: 0.2, checkpoint_seconds: 0.2}
"""
"""One group of four chunks."""

EPISODES = "episodes=1000"

HAS_SLURM = os.geteuid() == 0 and all(map(shutil.which, ("slurmctld", "slurmd", "munged", "sbatch")))


ROOT = Path(__file__).parents[2]


def search_path() -> dict[str, str]:
    """The environment of a process that imports this bojax, and else what this process finds."""
    return {"PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])}


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / f"{name}.parquet").read_bytes() for name in ("runs", "episodes")}


def wait_until(condition, process: subprocess.Popen | None = None, seconds: float = 400.0) -> None:
    """Wait for a condition, while a process runs if there is one."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.1)


def running(attempts: AttemptRegistry, *, with_checkpoint: bool = False) -> list[int]:
    """The processes that run chunks, or those that have saved a checkpoint of one."""
    found = set()
    for chunk in attempts.begun():
        number = attempts.newest(chunk)
        attempt = attempts.attempt(chunk, number)
        has_ended = attempts.has_ended(chunk) or attempts.paused.get(chunk) == number
        if has_ended or not attempt or not attempt.process or is_gone(attempt.process):
            continue
        if not with_checkpoint or any(attempts.path(chunk, number).glob("checkpoint-*")):
            found.add(int(attempt.process[2]))
    return sorted(found)


def running_in(out: Path, *, with_checkpoint: bool = False) -> list[int]:
    """The same for a results folder; none if nothing has begun there."""
    if not (out / WORK).is_dir():
        return []
    return running(AttemptRegistry(out / WORK, out), with_checkpoint=with_checkpoint)


@contextlib.contextmanager
def slurm(folder: Path) -> Iterator[Path]:
    """Slurm's daemons on this machine; the configuration file that names them."""
    script = Path(__file__).with_name("slurm_cluster.sh")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = min(free.getsockname()[1], 65000)
    environment = {**os.environ, "SLURM_PORT": str(port)}
    subprocess.run([script, folder, "start"], check=True, timeout=120, env=environment)
    try:
        yield folder / "slurm.conf"
    finally:
        subprocess.run([script, folder, "stop"], check=True)
