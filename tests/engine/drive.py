"""Runs a toy sweep, in this process or as `python -m tests.engine.drive OUT KEY=VALUE ...`."""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
COMMAND = ["bojax", "sweep", "toy"]


def run_toy(out: Path | None, *points: dict, resume: bool = False, **settings) -> int:
    """Run or resume a toy sweep; the exit code."""
    from tests.toy import toy_sweep

    return run_sweep(toy_sweep(*points, **settings), out, resume, COMMAND)


def run_sweep(sweep, out: Path | None, resume: bool = False, command: list[str] = COMMAND) -> int:
    """Run or resume a sweep; the exit code."""
    from bojax.engine.run import Request, run_sweeps

    return run_sweeps([Request(sweep, out)], resume, command)


def start_toy(out: Path, *options: str, resume: bool = False, env=None, **settings) -> subprocess.Popen:
    """The same in a process of its own; `options` are Python statements to run before it."""
    arguments = json.dumps({"out": str(out), "resume": resume, **settings})
    command = [sys.executable, "-m", "tests.engine.drive", arguments, *options]
    return subprocess.Popen(
        command, cwd=ROOT, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def contents(folder: Path) -> dict[str, bytes]:
    """All content of a results folder that an interruption must not change."""
    files = [folder / name for name in ("runs.parquet", "steps.parquet")]
    files += sorted((folder / "arrays").glob("*.npz"))
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


if __name__ == "__main__":
    import tests.strict  # noqa: F401
    from bojax.cli.main import leave

    given = json.loads(sys.argv[1])
    for option in sys.argv[2:]:
        exec(option)
    leave(run_toy(Path(given.pop("out")), *given.pop("points", ()), **given))
