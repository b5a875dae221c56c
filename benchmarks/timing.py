"""Timing of runs in batches, and the table and JSON record of the results."""

import json
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from isolated import describe_cores
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from rich.console import Console
from rich.table import Table

from bojax.numerics.lanes import LANES


@dataclass(frozen=True)
class Row:
    """One row of the table.

    Attributes:
        what: Name of the measured program.
        runs: Number of runs at once.
        seconds: Median seconds over the repeats.
        work: Units of work done in these seconds, such as iterations.
        compile_seconds: Seconds of compilation, not included in `seconds`.
    """

    what: str
    runs: int
    seconds: float
    work: int
    compile_seconds: float = 0.0

    @property
    def rate(self) -> float:
        """Units of work per second."""
        return self.work / self.seconds


def on_gpu() -> bool:
    """Whether JAX runs on an accelerator."""
    return jax.default_backend() != "cpu"


def time_runs(
    what: str,
    function: Callable,
    runs: int,
    lanes: int,
    work: int,
    repeats: int,
    prepare: Callable | None = None,
) -> Row:
    """Time `function(run)` for `runs` runs, compiled, in equal batches of at most `lanes`.

    Args:
        what: Name of the program.
        function: Maps the index of a run to its result, which must differ between runs.
        runs: Number of runs, rounded up to whole batches.
        lanes: Maximum number of runs at once, on all devices together.
        work: Units of work of one run.
        repeats: Number of repeats.
        prepare: Maps the index of a run to a second argument of `function`; not timed.

    Raises:
        AssertionError: Two runs gave the same result.
    """
    mesh = jax.make_mesh((1 if runs == 1 else jax.device_count(),), ("devices",), (AxisType.Auto,))
    by_lane = PartitionSpec("devices")
    num_batches = -(-runs // lanes)
    lanes = -(-runs // (num_batches * mesh.size)) * mesh.size
    index = np.arange(num_batches * lanes, dtype=np.int32).reshape(num_batches, lanes)

    def sharded(function: Callable) -> Any:
        lanes = jax.vmap(function, axis_name=LANES)
        return jax.jit(jax.shard_map(lanes, mesh=mesh, in_specs=by_lane, out_specs=by_lane, check_vma=False))

    batches = [(jax.device_put(lane, NamedSharding(mesh, by_lane)),) for lane in index]
    if prepare is not None:
        prepared = sharded(prepare)
        batches = jax.block_until_ready([(run, prepared(run)) for (run,) in batches])

    start = time.perf_counter()
    program = sharded(function).lower(*batches[0]).compile()
    compile_seconds = time.perf_counter() - start

    results = np.concatenate([_flat(program(*batch), lanes) for batch in batches])
    if len(np.unique(results, axis=0)) < len(results):
        raise AssertionError(f"{what}: two runs gave the same result; each run must differ")
    seconds = median_seconds(lambda: [program(*batch) for batch in batches], repeats)
    return Row(what, index.size, seconds, index.size * work, compile_seconds)


def _flat(result: Any, lanes: int) -> np.ndarray:
    leaves = [np.asarray(leaf).reshape(lanes, -1) for leaf in jax.tree.leaves(result)]
    return np.concatenate(leaves, axis=1)


def median_seconds(function: Callable[[], Any], repeats: int) -> float:
    """Median of the seconds until the result of `function` is ready.

    On a single CPU core this is the CPU time of the process, which other processes do not affect; otherwise
    it is wall time.
    """
    is_one_core = not on_gpu() and describe_cores() == "1 core"
    clock = time.process_time if is_one_core else time.perf_counter
    seconds = []
    for _ in range(repeats):
        start = clock()
        jax.block_until_ready(function())
        seconds.append(clock() - start)
    return statistics.median(seconds)


def describe_device() -> str:
    """The devices of JAX and the cores of this process."""
    return f"{jax.device_count()} x {jax.devices()[0].device_kind}, {describe_cores()}"


def print_rows(title: str, unit: str, rows: Sequence[Row], peer: str) -> None:
    """Print a table; its last column is the rate relative to the first row, which is that of `peer`."""
    table = Table(title=f"{title} ({describe_device()})")
    table.add_column("")
    for name in ("runs", "seconds", "compile, s", f"{unit}/s", f"x {peer}"):
        table.add_column(name, justify="right")
    for row in rows:
        compiled = f"{row.compile_seconds:.1f}" if row.compile_seconds else ""
        ratio = f"{row.rate / rows[0].rate:.1f}"
        table.add_row(row.what, str(row.runs), f"{row.seconds:.4f}", compiled, f"{row.rate:,.0f}", ratio)
    Console().print(table)


def write_record(
    path: Path, benchmark: str, unit: str, rows: Sequence[Row], settings: Mapping[str, Any]
) -> None:
    """Write the rows, the device and the settings to a JSON file."""
    record = {
        "benchmark": benchmark,
        "device": describe_device(),
        "jax": jax.__version__,
        "settings": settings,
        "rows": [
            {
                "what": row.what,
                "runs": row.runs,
                "seconds": row.seconds,
                unit: row.work,
                "compile_seconds": row.compile_seconds,
                f"{unit}_per_second": row.rate,
            }
            for row in rows
        ],
    }
    path.write_text(json.dumps(record, indent=2) + "\n")
