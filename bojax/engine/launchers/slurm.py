"""Slurm: one array of workers, submitted by `sbatch`."""

import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from typing_extensions import override

from bojax.config.launching import SlurmConfig
from bojax.engine.errors import EngineError
from bojax.engine.remote import Launcher
from bojax.results.store import WORK, write_atomically

SCRIPT = "slurm.sh"
"""The script of the last submission, in the results folder."""

NOTICE_SECONDS = 120
"""Time before the limit at which Slurm tells a worker to stop at a checkpoint."""


class Slurm(Launcher):
    """Submits an array and returns.

    Slurm starts a task again that nears its time limit or whose node fails. A cancelled task stops at a
    checkpoint, and is not started again.
    """

    is_awaited = False

    def __init__(self, config: SlurmConfig):
        self._config = config

    @override
    def check(self, name: str) -> None:
        _sbatch(self.script(name, [Path("results")]), "--test-only")

    @override
    def start(self, name: str, folders: Sequence[Path]) -> None:
        text = self.script(name, folders)
        for folder in folders:
            write_atomically(folder / SCRIPT, lambda temporary: temporary.write_text(text))
        print(f"submitted job {_sbatch(text, '--parsable')} of {self._config.tasks} tasks")

    def script(self, name: str, folders: Sequence[Path]) -> str:
        """The batch script of an array of workers for the sweeps in these folders."""
        config, paths = self._config, [folder.absolute() for folder in folders]
        options = {
            "job-name": f"bojax-{name}".replace(", ", "-"),
            "array": f"0-{config.tasks - 1}",
            "open-mode": "append",
            "signal": f"B:USR2@{NOTICE_SECONDS}",
            "output": paths[0] / WORK / "slurm-%A_%a.out",
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
                f'exec {shlex.join(worker)} --share "$SLURM_ARRAY_TASK_ID/{config.tasks}"',
                "",
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
        reason = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        raise EngineError(f"--launcher slurm: {' '.join(reason) or f'exit code {done.returncode}'}")
    return done.stdout.strip()
