"""Small sweeps that the campaign interrupts, and what must be the same after an interruption."""

import atexit
import functools
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.campaign.case import fault_of
from benchmarks.campaign.process import cli, run

ROOT = Path(__file__).parents[2]

_TOY_POINTS = ({"scale": 1.0, "max_length": 60}, {"scale": 2.0, "max_length": 60}, {"max_length": 30})
"""Two static groups; with three lanes on a device, each of several chunks."""


@dataclass(frozen=True)
class Workload:
    """A sweep that takes seconds."""

    name: str  # what cases call it
    words: tuple[str, ...]  # the command line, but for `--out`; empty for the toy, which compiles quickly

    def start(self, out: Path, *, resume: bool = False, report: bool = False) -> Callable[[], int]:
        """A function that runs or resumes it, writing into `out`, with or without its report."""
        return functools.partial(_start, self, out, resume, report)

    def start_afresh(self, out: Path, *options: str, resume: bool = False) -> Callable[[], int]:
        """The same as `python -m bojax`, imports and report included; not for the toy."""
        words = [sys.executable, "-m", "bojax", *self.words, *options, *_target(out, resume)]
        return lambda: os.execve(sys.executable, words, {**os.environ, "PYTHONPATH": str(ROOT)})


_EVERY_ADVANCE = " engine.segment_seconds=0.000001 engine.checkpoint_seconds=0.000001"
"""Every advance is a segment and leaves a checkpoint."""

_WORDS = {
    "toy": "",
    "tabular": "run cliff-walking --runs 6 episodes=30 env.max_steps=100" + _EVERY_ADVANCE,
    "planning": "run parking --runs 4 planner.iterations=5 problem.max_steps=8" + _EVERY_ADVANCE,
    "monitoring": "run two-pits --runs 3 planner.iterations=3 problem.max_steps=6 problem.resolution=5"
    + _EVERY_ADVANCE,
    "learner": "run mountain-car --runs 2 episodes=4 env.max_steps=30 learner.features.num_features=20"
    " record.learners=true" + _EVERY_ADVANCE,
    "hosted": f"run {ROOT}/examples/my_gym_env.yaml --runs 2 episodes=3 env.max_steps=20"
    " learner.features.num_features=20 record.learners=false" + _EVERY_ADVANCE,
    "variants": "sweep fig-5.2a --runs 4 episodes=40 env.max_steps=60",
    "shared": f"sweep {Path(__file__).with_name('shared.yaml')}",
}
WORKLOADS = {name: Workload(name, tuple(words.split())) for name, words in _WORDS.items()}


def contents(folder: Path) -> dict[str, bytes]:
    """Everything in a results folder that an interruption must not change, by name."""
    files = [folder / f"{name}.parquet" for name in ("runs", "steps", "episodes")]
    files += sorted((folder / "arrays").glob("*.npz"))
    files += sorted((folder / "learners").glob("*/experiment.yaml"))
    return {str(path.relative_to(folder)): path.read_bytes() for path in files if path.is_file()}


def difference(found: dict[str, bytes], wanted: dict[str, bytes]) -> str:
    """How two results differ; empty if they do not."""
    names = sorted(found.keys() ^ wanted.keys()) or sorted(
        name for name, content in wanted.items() if found[name] != content
    )
    return f"not the bytes of an uninterrupted sweep: {', '.join(names[:4])}" if names else ""


def fault_in(out: Path, name: str) -> str:
    """How a results folder differs from that of the uninterrupted workload; empty if it does not."""
    return difference(contents(out), contents(finished(name)))


def resumed(name: str, out: Path, place: Path) -> str:
    """Resume a workload; why it does not end in the bytes of an uninterrupted one, empty if it does."""
    fault = fault_of(run(WORKLOADS[name].start(out, resume=True), place), (0,))
    return f"resuming: {fault}" if fault else fault_in(out, name)


@functools.cache
def finished(name: str) -> Path:
    """The results folder of a workload that nothing has interrupted."""
    out = _shared() / f"{name}-finished"
    ended = run(WORKLOADS[name].start(out, report=True), _shared(), seconds=600)
    assert ended.code == 0, ended.err
    return out


@functools.cache
def duration(name: str) -> float:
    """Seconds that a workload takes here, with its programs cached."""
    finished(name)
    return run(WORKLOADS[name].start(_shared() / f"{name}-timed"), _shared()).wall


@functools.cache
def interrupted(name: str, pieces: int) -> Path:
    """The folder of a workload that was interrupted when it had some pieces, each committed."""
    out = _shared() / f"{name}-interrupted-{pieces}"

    def interrupt() -> None:
        while len(list(out.glob(".work/chunk-*/piece-*.parquet"))) < pieces:
            time.sleep(0.001)
        os.kill(os.getpid(), signal.SIGINT)

    def start() -> int:
        threading.Thread(target=interrupt, daemon=True).start()
        return WORKLOADS[name].start(out)()

    ended = run(start, _shared(), seconds=600)
    assert ended.code == 130, ended
    return out


def _target(out: Path, resume: bool) -> list[str]:
    return ["--out", str(out), *(["--resume"] if resume else [])]


def _start(workload: Workload, out: Path, resume: bool, report: bool) -> int:
    if not report:
        import bojax.report.build

        # Patched by name, where the command line imports it: a report takes longer than these sweeps.
        bojax.report.build.build_report = lambda folder, *_: folder / "report.html"
    if workload.words:
        return cli(*workload.words, *_target(out, resume))
    from bojax.engine.run import run_sweeps
    from bojax.engine.targets import Request
    from tests.toy import toy_sweep

    sweep = toy_sweep(*_TOY_POINTS, runs=6, lanes_per_device=3, segment_seconds=1e-6, checkpoint_seconds=1e-6)
    return run_sweeps([Request(sweep, out)], resume, ["bojax", "sweep", "toy"])


@functools.cache
def _shared() -> Path:
    """A folder for what several cases start from, removed at the end."""
    folder = Path(tempfile.mkdtemp(prefix="bojax-campaign-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
