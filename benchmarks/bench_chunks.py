"""The time and the memory that the driver of a cluster needs for a sweep of very many chunks.

The benchmark makes a results folder in which workers have computed all chunks; their rows are made up.
Another process plans the sweep and merges it, which is timed.
"""

import argparse
import json
import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from options import positive

if TYPE_CHECKING:
    from bojax.engine.sweep_run import SweepRun

QUEUE = 64
"""Runs of a chunk on a CPU."""

EXAMPLES = """\
  python benchmarks/bench_chunks.py                                       2,000 chunks
  python benchmarks/bench_chunks.py --chunks 100000 --folder /dev/shm     6.4 million runs, in memory
"""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    context = multiprocessing.get_context("spawn")  # each step in a process of its own, for its memory
    found: dict[str, Any] = {"chunks": args.chunks}
    with tempfile.TemporaryDirectory(dir=args.folder) as place:
        for step in (_make, _merge):
            with context.Pool(1) as pool:
                found |= pool.apply(step, (Path(place) / "many-chunks", args.chunks))
    print(json.dumps(found, indent=1))
    if args.json:
        args.json.write_text(json.dumps({"benchmark": "chunks"} | found, indent=1) + "\n")
    return 0


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n")[0],
        epilog=f"examples:\n{EXAMPLES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--chunks", type=positive, default=2000, help="number of chunks (2000)")
    parser.add_argument("--folder", type=Path, help="where the results folder is made for a while")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to a file")
    return parser.parse_args(argv)


def _sweep_run(folder: Path, chunks: int, *, is_resumed: bool) -> tuple["SweepRun", float]:
    """The sweep in its folder, and the processor time that the plan took."""
    import jax

    from bojax.config.sweep import load_sweep
    from bojax.engine.devices import prepare
    from bojax.engine.plan import make_plan
    from bojax.engine.sweep_run import SweepRun
    from bojax.engine.targets import Target

    prepare("cpu")
    content = {
        "base": {"experiment": "learning", "env": "cliff-walking", "learner": "additive", "episodes": 2},
        "runs": QUEUE * chunks,
        "record": {"runs": 0},
    }
    sweep, devices = load_sweep(content), jax.devices("cpu")[:1]
    seconds, plan = _timed(lambda: make_plan(sweep, devices))
    assert len(plan.chunks) == chunks
    target = Target(sweep, folder, is_resumed=is_resumed, may_rename=False)
    return SweepRun(plan, target, ["many", "chunks"]), seconds


def _make(folder: Path, chunks: int) -> dict[str, float]:
    """A folder with the files that workers leave, of made-up rows."""
    import numpy as np

    from bojax.results import chunk_folder, store
    from bojax.results.tables import KEYS, to_arrow

    run, seconds = _sweep_run(folder, chunks, is_resumed=False)
    run.open()
    chunk_folder.sync = store.sync = lambda *paths: None  # a power failure loses nothing of value here
    storage = run.launch()
    tables = run.plan.modules[0].tables
    for chunk in run.plan.chunks:
        sink = storage.open(chunk)
        assert sink is not None
        for number, is_last in ((0, False), (1, True)):
            rows = {}
            for name, columns in tables.items():
                if name == "steps" or (name == "runs") != is_last:
                    continue
                made: dict[str, Any] = {"point": chunk.points, "run": chunk.runs}
                for column in columns:
                    value = number if column.dtype.startswith(("int", "bool")) or column.words else 0.5
                    made[column.name] = np.full(chunk.num_runs, value)
                rows[name] = to_arrow(KEYS + columns, made)
            sink.write_piece(rows)
            sink.state.segments.append([QUEUE, 100, 0.01])
        sink.finish()
        storage.close(chunk, sink)
    run.folder.close(finished=False)
    return {"plan_cpu_seconds": seconds}


def _merge(folder: Path, chunks: int) -> dict[str, float]:
    run, _ = _sweep_run(folder, chunks, is_resumed=True)
    before = _megabytes()
    start = time.perf_counter()
    opened, _ = _timed(run.open)
    merged, _ = _timed(lambda: run.finalise(print, bool))
    return {
        "open_cpu_seconds": opened,
        "merge_cpu_seconds": merged,
        "cpu_milliseconds_per_chunk": 1000 * (opened + merged) / chunks,
        "wall_seconds": time.perf_counter() - start,
        "megabytes_of_the_plan": before,
        "megabytes_at_most": _megabytes(),
    }


def _timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of processor time, which a busy machine does not change much, and the result."""
    start = time.process_time()
    found = function()
    return time.process_time() - start, found


def _megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
