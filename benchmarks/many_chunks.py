"""Plans and merges a sweep of very many chunks, as the driver of a cluster does.

`python -m benchmarks.many_chunks FOLDER --chunks 100000` makes a folder in which workers have computed all
chunks (their rows are made up), and merges it in a process of its own. It prints the processor time
of each step, and the most memory that the process held.
"""

import argparse
import json
import multiprocessing
import resource
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

QUEUE = 64
"""Runs of a chunk on a CPU."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="a new folder; it is deleted at the end")
    parser.add_argument("--chunks", type=int, default=100_000)
    args = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    found: dict[str, Any] = {"chunks": args.chunks}
    try:
        for step in (_make, _merge):
            with context.Pool(1) as pool:
                found |= pool.apply(step, (args.folder, args.chunks))
    finally:
        shutil.rmtree(args.folder, ignore_errors=True)
    print(json.dumps(found, indent=1))


def _journal(folder: Path, chunks: int, *, is_resumed: bool) -> tuple[Any, float]:
    """The journal of the sweep, and the processor time that the plan took."""
    import jax

    from bojax.config.sweep import load_sweep
    from bojax.engine.devices import prepare
    from bojax.engine.journal import Journal
    from bojax.engine.plan import make_plan

    prepare("cpu")
    content = {
        "base": {"experiment": "learning", "env": "cliff-walking", "learner": "additive", "episodes": 2},
        "runs": QUEUE * chunks,
        "record": {"runs": 0},
    }
    sweep, devices = load_sweep(content), jax.devices("cpu")[:1]
    seconds, plan = _timed(lambda: make_plan(sweep, devices))
    assert len(plan.chunks) == chunks
    return Journal(plan, folder, "many chunks", is_resumed=is_resumed, may_rename=False), seconds


def _make(folder: Path, chunks: int) -> dict[str, float]:
    """A folder with the files that workers leave, of made-up rows."""
    import numpy as np

    from bojax.results import parts, store
    from bojax.results.tables import KEYS, to_arrow

    journal, seconds = _journal(folder, chunks, is_resumed=False)
    journal.open()
    parts.sync = store.sync = lambda *paths: None  # a power failure loses nothing of value here
    share = journal.share
    tables = journal.plan.modules[0].tables
    for chunk in journal.plan.chunks:
        sink = share.take(chunk)
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
            sink.write_part(rows)
            sink.state.segments.append([QUEUE, 100, 0.01])
        sink.finish()
        share.release(chunk, sink)
    journal.close()
    return {"plan_cpu_seconds": seconds}


def _merge(folder: Path, chunks: int) -> dict[str, float]:
    journal, _ = _journal(folder, chunks, is_resumed=True)
    before = _megabytes()
    start = time.perf_counter()
    opened, _ = _timed(journal.open)
    merged, _ = _timed(journal.merge)
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
    main()
