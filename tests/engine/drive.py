"""Runs a toy sweep, in this process or as `python -m tests.engine.drive OUT KEY=VALUE ...`."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from tests.compiling import IS_CPU

ROOT = Path(__file__).parents[2]
COMMAND = ["bojax", "sweep", "toy"]

NEEDS_CPU = pytest.mark.skipif(not IS_CPU, reason="counts the chunks of a CPU")
"""On a GPU, all runs of a small group are one chunk."""


def run_toy(out: Path | None, *points: dict, resume: bool = False, devices=None, **settings) -> int:
    """Run or resume a toy sweep; the exit code."""
    from tests.toy import toy_sweep

    return run_sweep(toy_sweep(*points, **settings), out, resume, devices=devices)


def run_sweep(
    sweep, out: Path | None, resume: bool = False, command: list[str] = COMMAND, devices=None
) -> int:
    """Run or resume a sweep, by default on one device; the exit code."""
    from bojax.engine.run import run_sweeps
    from bojax.engine.targets import Request

    return run_sweeps([Request(sweep, out)], resume, command, indices=devices)


def plan_sweep(sweep, out: Path) -> None:
    """Start a sweep that is left to workers."""
    from bojax.engine.plan import make_plan
    from bojax.engine.sweep_run import SweepRun
    from bojax.engine.targets import Target

    target = Target(sweep, out, is_resumed=False, may_rename=False)
    run = SweepRun(make_plan(sweep, jax.devices()[:1]), target, COMMAND)
    run.open()
    run.launch()
    run.folder.close(finished=False)


def work_on(*folders: Path, stop=bool, **options) -> int:
    """Run chunks of toy sweeps in this process; the exit code."""
    from bojax.engine.worker import guarded, run_worker

    here = os.getcwd()
    with pytest.MonkeyPatch.context() as patch:
        knows_toys(patch)
        try:
            return guarded(lambda: run_worker(folders, stop, **options))
        finally:
            os.chdir(here)


def knows_toys(patch: pytest.MonkeyPatch) -> None:
    """Let workers read the settings of toys, which are not registered."""
    from tests.toy import ToyConfig

    patch.setattr("bojax.config.saved_sweep.validate_experiment", lambda config: ToyConfig(**config))


SLOWLY = """
import time
from bojax.engine.storage import FolderSink
write = FolderSink.write_piece
FolderSink.write_piece = lambda *arguments: (time.sleep(0.02), write(*arguments))
"""
"""Statements after which a chunk of toys lasts long enough to be disturbed, also on a busy machine."""


def start_worker(out: Path, *words: str) -> subprocess.Popen:
    """`bojax worker` for toys, which takes its time."""
    return start_toy(out, SLOWLY, words=words)


def start_toy(
    out: Path, *options: str, resume: bool = False, env=None, before=(), streams=None, **settings
) -> subprocess.Popen:
    """The same in a process of its own, whose output is read from pipes by default.

    `options` are Python statements to run before it, and `before` is a command that runs it.
    """
    arguments = json.dumps({"out": str(out), "resume": resume, **settings})
    command = [*before, sys.executable, "-m", "tests.engine.drive", arguments, *options]
    streams = streams or {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, cwd=ROOT, env=env, text=True, **streams)


def contents(folder: Path) -> dict[str, bytes]:
    """All content of a results folder that an interruption must not change."""
    files = [folder / name for name in ("runs.parquet", "steps.parquet")]
    files += sorted((folder / "arrays").glob("*.npz"))
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def one_error(capsys) -> str:
    """The only line of the standard error stream that is an error."""
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    return line


if __name__ == "__main__":
    import tests.strict  # noqa: F401
    from bojax.cli.main import leave

    given = json.loads(sys.argv[1])
    for option in sys.argv[2:]:
        exec(option)
    if "words" in given:
        from bojax.cli.worker import main

        knows_toys(pytest.MonkeyPatch())
        leave(main("worker", [given["out"], *given["words"]]))
    leave(run_toy(Path(given.pop("out")), *given.pop("points", ()), **given))
