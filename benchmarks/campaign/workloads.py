"""Small sweeps that the campaign interrupts, and what must be the same after an interruption."""

import functools
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.campaign.process import Ended, run

OFTEN = ["engine.segment_seconds=0.000001", "engine.checkpoint_seconds=0.000001"]
"""Every advance is a segment and leaves a checkpoint."""

_TOY_POINTS = ({"scale": 1.0, "max_length": 60}, {"scale": 2.0, "max_length": 60}, {"max_length": 30})
"""Two static groups; with four lanes on a device, each of several chunks."""

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Workload:
    """A sweep that takes seconds.

    Attributes:
        name: What cases call it.
        words: The command line, but for `--out`; empty for the toy experiment, which needs no compilation
            to speak of.
    """

    name: str
    words: tuple[str, ...] = ()

    def start(self, out: Path, *, resume: bool = False, report: bool = False) -> Callable[[], int]:
        """A function that runs or resumes it, writing into `out`, with or without its report."""
        return functools.partial(_start, self, out, resume, report)

    def start_afresh(self, out: Path, *options: str, resume: bool = False) -> Callable[[], int]:
        """The same as `python -m bojax`, imports and report included; not for the toy."""
        words = [
            sys.executable,
            "-m",
            "bojax",
            *self.words,
            *options,
            "--out",
            str(out),
            *(["--resume"] if resume else []),
        ]
        return lambda: os.execve(sys.executable, words, {**os.environ, "PYTHONPATH": str(ROOT)})


WORKLOADS = {
    workload.name: workload
    for workload in (
        Workload("toy"),
        Workload(
            "tabular", ("run", "cliff-walking", "--runs", "6", "episodes=30", "env.max_steps=100", *OFTEN)
        ),
        Workload(
            "planning",
            ("run", "parking", "--runs", "4", "planner.iterations=5", "problem.max_steps=8", *OFTEN),
        ),
        Workload(
            "monitoring",
            (
                *("run", "two-pits", "--runs", "3", "planner.iterations=3", "problem.max_steps=6"),
                *("problem.resolution=5", *OFTEN),
            ),
        ),
        Workload(
            "learner",
            (
                *("run", "mountain-car", "--runs", "2", "episodes=4", "env.max_steps=30"),
                *("learner.features.num_features=20", "record.learners=true", *OFTEN),
            ),
        ),
        Workload(
            "hosted",
            (
                *("run", str(ROOT / "examples" / "my_gym_env.yaml"), "--runs", "2", "episodes=3"),
                *("env.max_steps=20", "learner.features.num_features=20", "record.learners=false", *OFTEN),
            ),
        ),
        Workload(
            "variants",
            ("sweep", "fig-5.2a", "--runs", "4", "episodes=40", "env.max_steps=60"),
        ),
        Workload("shared", ("sweep", str(Path(__file__).with_name("shared.yaml")))),
    )
}


def contents(folder: Path) -> dict[str, bytes]:
    """Everything in a results folder that an interruption must not change, by name."""
    files = [folder / f"{name}.parquet" for name in ("runs", "steps", "episodes")]
    files += sorted((folder / "arrays").glob("*.npz"))
    files += sorted((folder / "learners").glob("*/experiment.yaml"))
    return {str(path.relative_to(folder)): path.read_bytes() for path in files if path.is_file()}


def merged(folder: Path) -> list[str]:
    """Tables that a sweep writes when all of it is done."""
    return [path.name for path in sorted(folder.glob("*.parquet"))]


def difference(found: dict[str, bytes], wanted: dict[str, bytes]) -> str:
    """How two results differ; empty if they do not."""
    names = sorted(found.keys() ^ wanted.keys()) or sorted(
        name for name, content in wanted.items() if found[name] != content
    )
    return f"not the bytes of an uninterrupted sweep: {', '.join(names[:4])}" if names else ""


@functools.cache
def finished(name: str) -> Path:
    """The results folder of a workload that nothing has interrupted."""
    out = _shared() / f"{name}-finished"
    ended = run(WORKLOADS[name].start(out, report=True), _shared(), seconds=600)
    assert ended.code == 0, ended.err
    return out


@functools.cache
def interrupted(name: str, parts: int) -> Path:
    """The folder of a workload that was interrupted when it had some parts, each committed."""
    out = _shared() / f"{name}-interrupted-{parts}"

    def start() -> int:
        _interrupt_at(out, parts)
        return WORKLOADS[name].start(out)()

    ended = run(start, _shared(), seconds=600)
    assert ended.code == 130, ended
    return out


def resume(name: str, out: Path, place: Path) -> Ended:
    """Take a workload up again."""
    return run(WORKLOADS[name].start(out, resume=True), place)


def _interrupt_at(out: Path, parts: int) -> None:
    """Have this process interrupted as soon as its folder has some parts."""
    import threading

    def watch() -> None:
        while len(list(out.glob(".work/chunk-*/piece-*.parquet"))) < parts:
            time.sleep(0.001)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=watch, daemon=True).start()


def _start(workload: Workload, out: Path, resume: bool, report: bool) -> int:
    if not report:
        import bojax.report.build

        # Patched by name, where the command line imports it: a report takes longer than these sweeps.
        bojax.report.build.build_report = lambda folder, *_: folder / "report.html"
    if not workload.words:
        from bojax.engine.run import run_sweeps
        from bojax.engine.targets import Request
        from tests.toy import toy_sweep

        sweep = toy_sweep(
            *_TOY_POINTS, runs=6, lanes_per_device=3, segment_seconds=1e-6, checkpoint_seconds=1e-6
        )
        return run_sweeps([Request(sweep, out)], resume, ["bojax", "sweep", "toy"])
    from bojax.cli.main import main

    return main([*workload.words, "--out", str(out), *(["--resume"] if resume else [])])


@functools.cache
def _shared() -> Path:
    """A folder for what several cases start from, removed at the end."""
    import atexit

    folder = Path(tempfile.mkdtemp(prefix="bojax-campaign-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
