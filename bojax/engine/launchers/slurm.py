"""Slurm: one array of workers, submitted by `sbatch`."""

import contextlib
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from typing_extensions import override

from bojax.config.errors import control_character, shown
from bojax.config.launching import SlurmConfig
from bojax.engine.errors import EngineError
from bojax.engine.remote import Launcher, num_shares
from bojax.results.store import OUTPUT, WORK, ResultsError, read_json, write_content, write_json

SCRIPT = "slurm.sh"
"""The script of the last submission, in the results folder."""

NOTICE_SECONDS = 120
"""Time before the limit at which Slurm tells a worker to stop at a checkpoint."""

ASK_SECONDS = 15.0
"""Interval at which Slurm is asked whether an array has ended."""

STOP_SECONDS = 60.0
"""Maximum time for the tasks of a cancelled array to reach a checkpoint."""


JOB = "slurm-job.json"
"""The file in `.work` that names the last submission."""

RUN = """\
trap 'kill -USR2 "$worker"' USR2  # Slurm's notice before the time limit goes to this shell alone
trap : TERM
{worker} --share "$SLURM_ARRAY_TASK_ID/{shares}" &
worker=$!
wait "$worker" && code=0 || code=$?
while kill -0 "$worker" 2> /dev/null; do wait "$worker" && code=0 || code=$?; done  # after a trap
case $code in
    140) scontrol requeue "$SLURM_JOB_ID" ;;  # USR2: stopped at a checkpoint
    129 | 130 | 143) ;;  # asked to stop
    *) [ "$code" -gt 128 ] && [ "${{SLURM_RESTART_COUNT:-0}}" -eq 0 ] && scontrol requeue "$SLURM_JOB_ID" ;;
esac
exit "$code"
"""
"""The end of the script. Slurm requeues a task whose node is lost. A worker that dies of a signal is requeued
with the same share, unless its task has been requeued before."""


class Slurm(Launcher):
    """Submits an array and returns, or waits for it, and cancels it if the driver is interrupted.

    Each task of the array runs a share of the chunks, and `tasks` of them at a time. A task that nears its
    time limit, or whose node or worker is lost, is started again. A cancelled task stops at a checkpoint, and
    is not started again.
    """

    def __init__(self, config: SlurmConfig, *, waits: bool = False):
        self._config = config
        self.is_awaited = waits
        self._job: list[str] = []  # the words that name it to Slurm's commands; empty once it has ended
        self._next_question = 0.0

    @override
    def check(self, name: str) -> None:
        _sbatch(self.script(name, [Path("results")], self._config.tasks), "--test-only")

    @override
    def has_begun(self, folders: Sequence[Path]) -> bool:
        with contextlib.suppress(ResultsError, TypeError):
            self._job = [str(word) for word in read_json(folders[0] / WORK / JOB)]
            self._ask()
        if self._job:
            self._say(
                f"job {self._job[-1]} still runs these sweeps; nothing is submitted (to stop it: scancel)"
            )
        return bool(self._job)

    @override
    def start(self, name: str, folders: Sequence[Path], groups: int, chunks: int) -> None:
        self._cancel()
        shares = num_shares(self._config.tasks, groups, chunks)
        text = self.script(name, folders, shares)
        for folder in folders:
            write_content(folder / SCRIPT, text)
        job, _, cluster = _sbatch(text, "--parsable").partition(";")  # a site may have several clusters
        self._job = [f"--clusters={cluster}", job] if cluster else [job]
        for folder in folders:
            write_json(folder / WORK / JOB, self._job)
        self._next_question = time.monotonic() + ASK_SECONDS
        self._say(f"submitted job {job} of {shares} tasks, {min(shares, self._config.tasks)} at a time")

    def _say(self, text: str) -> None:
        print(text, file=sys.stderr if self.is_awaited else sys.stdout)

    @override
    def keep(self) -> bool:
        if self._job and time.monotonic() >= self._next_question:
            self._next_question = time.monotonic() + ASK_SECONDS
            self._ask()
        return bool(self._job)

    def _ask(self) -> None:
        """Ask Slurm whether the array has ended."""
        *cluster, job = self._job
        # Its lines: the name of the cluster if one is given, and the array's job for each of its tasks.
        asked = ["squeue", "--noheader", *cluster, f"--jobs={job}", "--format=%F"]
        shown = subprocess.run(asked, capture_output=True, text=True)
        # A job that ended long ago is forgotten; any other failure of squeue says nothing about the job.
        is_forgotten = shown.returncode and "Invalid job id" in shown.stderr
        if is_forgotten or (not shown.returncode and job not in shown.stdout.split()):
            self._job = []

    @override
    def close(self) -> None:
        self._cancel()
        end = time.monotonic() + STOP_SECONDS
        while self.is_awaited and self._job and time.monotonic() < end:
            self._ask()
            time.sleep(1.0 if self._job else 0.0)

    def _cancel(self) -> None:
        """Cancel the tasks of the last array that run or have not begun."""
        if self.is_awaited and self._job:
            subprocess.run(["scancel", *self._job], capture_output=True, check=False)

    def script(self, name: str, folders: Sequence[Path], shares: int) -> str:
        """The batch script of an array of workers for the sweeps in these folders, divided into shares.

        Raises:
            EngineError: A name or a path has a line break, which would end its line in the script.
        """
        config, paths = self._config, [folder.absolute() for folder in folders]
        for text in (name, str(Path.cwd()), sys.executable, *map(str, paths)):
            if control_character(text, allows_breaks=False):
                raise EngineError(
                    f"--launcher slurm: got {shown(text)}; allowed: names and paths on one line"
                )
        options = {
            "job-name": f"bojax-{name}".replace(", ", "-"),
            "array": f"0-{shares - 1}%{config.tasks}",
            "open-mode": "append",
            "signal": f"B:USR2@{NOTICE_SECONDS}",
            "output": Path(str(paths[0]).replace("%", "%%")) / WORK / OUTPUT.format("%A_%a"),
            "partition": config.partition,
            "account": config.account,
            "time": config.time,
            "gpus-per-task": config.gpus_per_task or None,
            "ntasks": 1,
            "cpus-per-task": config.cpus_per_task,
            "mem": config.memory,
        }
        given = [
            f"--{option}={shlex.quote(str(value))}" for option, value in options.items() if value is not None
        ]
        worker = [sys.executable, "-m", "bojax", "worker", *map(str, paths)]
        if config.cpus_per_task is not None:  # not every cluster confines a task to its cores
            worker += ["--cores", str(config.cpus_per_task)]
        return "\n".join(
            [
                "#!/bin/bash",
                *(f"#SBATCH {option}" for option in ["--requeue", *given, *config.options]),
                *config.setup,
                f"cd {shlex.quote(str(Path.cwd()))} || exit 1",
                RUN.format(worker=shlex.join(worker), shares=shares),
            ]
        )


def _sbatch(script: str, option: str) -> str:
    """What `sbatch` prints about a script.

    Raises:
        EngineError: There is no Slurm, or it refuses the script.
    """
    try:
        done = subprocess.run(["sbatch", option], input=script, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise EngineError(
            "--launcher slurm: no sbatch on this machine; allowed: a login node of a Slurm cluster"
        ) from None
    if done.returncode:
        told = (done.stderr.strip() or done.stdout.strip()).splitlines()
        reason = [line for line in told if not line.startswith("Try ")][-1:]  # the last one may name --help
        raise EngineError(f"--launcher slurm: {' '.join(reason) or f'exit code {done.returncode}'}")
    return done.stdout.strip()
