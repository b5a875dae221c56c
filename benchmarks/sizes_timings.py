"""The timings of bench_sizes.py, run in a process with its own cores."""

import json
import math
import resource
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context

from bench_sizes import parse
from isolated import describe_cores
from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Cost:
    """The cost of one size of a curve; seconds of compilation are not in `seconds`, bytes are in `memory`."""

    curve: str
    size: int
    compile_seconds: float
    seconds: float
    memory: int


def main(argv: list[str]) -> int:
    """Measure all curves, and print a table of each."""
    args = parse(argv)
    # A server imports the cases once, and forks a process for each size before JAX has started a thread.
    context = get_context("forkserver")
    context.set_forkserver_preload(["sizes_cases"])
    costs: list[Cost] = []
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as pool:
        for curve in args.only:
            own: list[Cost] = []
            for size in (size for size in sizes(curve) if size <= args.largest):
                own.append(pool.submit(measured, curve, size, args.repeats).result())
                print(f"{curve}, {size:,}: {own[-1].seconds:.3g} s", file=sys.stderr, flush=True)
            print_costs(own)
            costs += own
    if args.json:
        record = {"benchmark": "sizes", "device": describe_cores(), "rows": [asdict(cost) for cost in costs]}
        args.json.write_text(json.dumps(record, indent=1) + "\n")
    return 0


def sizes(curve: str) -> Sequence[int]:
    """The sizes of a curve."""
    from sizes_cases import CASES

    return CASES[curve].sizes


def measured(curve: str, size: int, repeats: int) -> Cost:
    """The cost of one size, in this process."""
    from sizes_cases import CASES

    before = _peak()
    compile_seconds, seconds = CASES[curve].measure(size, repeats)
    return Cost(curve, size, compile_seconds, seconds, _peak() - before)


def _peak() -> int:
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return own * (1 if sys.platform == "darwin" else 1024)


def print_costs(costs: Sequence[Cost]) -> None:
    """Print a curve, with the local exponents of its seconds and of its memory."""
    from sizes_cases import CASES

    table = Table(title=f"{costs[0].curve}: {CASES[costs[0].curve].what} ({describe_cores()})")
    headings = "size", "compile, s", "run, s", "memory, MB", "exponent: compile", "run", "memory"
    for heading in headings:
        table.add_column(heading, justify="right")
    for before, cost in zip([None, *costs], costs, strict=False):
        numbers = [f"{cost.compile_seconds:.2f}", f"{cost.seconds:.3g}", f"{cost.memory / 1e6:.0f}"]
        if before is not None:
            numbers += [exponent(before, cost, name) for name in ("compile_seconds", "seconds", "memory")]
        table.add_row(f"{cost.size:,}", *numbers)
    Console(width=100).print(table)


def exponent(before: Cost, after: Cost, name: str) -> str:
    """The slope of a cost between two sizes, on logarithmic axes; empty where one is not positive."""
    low, high = getattr(before, name), getattr(after, name)
    if low <= 0 or high <= 0:
        return ""
    return f"{math.log(high / low) / math.log(after.size / before.size):.2f}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
