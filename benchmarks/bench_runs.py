"""The time of an experiment against its number of runs, beside the same steps in runs one after the other.

Every experiment is a command `bojax run` in a process of its own, after one of a single queue that fills the
cache of compiled programs. The peer is a single run: its steps per second. (Runs of a learner differ in
length.)
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from options import make_parser, positive

from bojax.numerics.lanes import LANES_ON_GPU

EXPERIMENTS = {
    "parking": ["parking"],
    "mountain-car": ["mountain-car"],
}
"""A planning experiment, 15 plans of kCBTS a run, and a learning one, EMU-Q up to its first success."""

EXAMPLES = """\
  python benchmarks/bench_runs.py                            1 to 1,000 runs
  python benchmarks/bench_runs.py --only parking --runs 1 100 10000 100000 --json gpu.json
  python benchmarks/bench_runs.py --results cpu.json gpu.json --plot runs.png
"""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    earlier = [row for path in args.results for row in json.loads(path.read_text())["rows"]]
    rows = list({(row["experiment"], row["device"], row["runs"]): row for row in earlier}.values())
    if not args.results:
        with tempfile.TemporaryDirectory() as place:
            for name in args.only:
                rows += measured(name, args, Path(place))
        print_table(rows)
    if args.json:
        args.json.write_text(json.dumps({"benchmark": "runs", "rows": rows}, indent=1) + "\n")
    if args.plot:
        plot(rows, args.plot)
    return 0


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument(
        "--runs",
        nargs="+",
        type=positive,
        default=[1, 10, 100, 1000],
        metavar="N",
        help="numbers of runs, the first of which is 1 (1 10 100 1000)",
    )
    parser.add_argument(
        "--only", nargs="+", choices=EXPERIMENTS, default=list(EXPERIMENTS), help="which experiments (all)"
    )
    parser.add_argument(
        "--seconds",
        type=positive,
        default=120,
        help="leave out numbers of runs that are expected to take longer (120)",
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the curves")
    parser.add_argument(
        "--results",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE",
        help="run nothing; use earlier results, for equal numbers of runs those of the last file",
    )
    args = parser.parse_args(argv)
    if args.runs[0] != 1 or args.runs != sorted(set(args.runs)):
        parser.error(f"--runs: got {' '.join(map(str, args.runs))}; allowed: 1 and larger numbers, in order")
    return args


def measured(name: str, args: argparse.Namespace, place: Path) -> list[dict[str, Any]]:
    """A row for each number of runs, up to the first that is expected to take too long."""
    rows: list[dict[str, Any]] = []
    for number in args.runs:
        if rows and number / rows[-1]["runs"] * rows[-1]["advancing"] > args.seconds:
            break
        queues = math.ceil(number / LANES_ON_GPU)
        one_queue = math.ceil(number / queues)  # the programs of all
        timed(EXPERIMENTS[name], one_queue, args, place / f"{name}-{number}-first")
        row = {"experiment": name} | timed(EXPERIMENTS[name], number, args, place / f"{name}-{number}")
        print(json.dumps(row), flush=True)
        rows.append(row)
    return rows


def timed(command: Sequence[str], runs: int, args: argparse.Namespace, out: Path) -> dict[str, Any]:
    """Seconds of a command with its start and its report, and seconds and steps of its advances alone.

    The advances of all cores or GPUs are added up.
    """
    options = [f"engine.device={args.device}", "record.runs=0", "--runs", str(runs), "--seed", str(args.seed)]
    words = [sys.executable, "-m", "bojax", "run", *command, *options, "--out", str(out)]
    start = time.perf_counter()
    subprocess.run(words, check=True, capture_output=True)
    seconds = time.perf_counter() - start
    manifest = json.loads((out / "manifest.json").read_text())
    return {
        "device": manifest["device"]["kind"],
        "runs": runs,
        "seconds": seconds,
        "advancing": sum(group["run_seconds"] for group in manifest["groups"]),
        "steps": sum(group["active_steps"] for group in manifest["groups"]),
    }


def print_table(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the seconds of each number of runs, and the ratio to single runs."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"Runs of an experiment ({rows[0]['device']})")
    for name in ("", "runs", "command, s", "advancing, device-s", "steps/s a device", "x a single run"):
        table.add_column(name, justify="right" if name else "left")
    for row in rows:
        rate = row["steps"] / row["advancing"]
        ratio = rate / single_rate(rows, row["experiment"], row["device"])
        numbers = f"{row['seconds']:.1f}", f"{row['advancing']:.3f}", f"{rate:,.0f}", f"{ratio:,.1f}"
        table.add_row(row["experiment"], f"{row['runs']:,}", *numbers)
    Console().print(table)


def single_rate(rows: Sequence[Mapping[str, Any]], experiment: str, device: str) -> float:
    """Steps per second of a single run on a device."""
    kind = {"experiment": experiment, "device": device, "runs": 1}
    one = next(row for row in rows if kind.items() <= row.items())
    return one["steps"] / one["advancing"]


def plot(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw the seconds against the number of runs, on logarithmic axes, of every device."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(row["experiment"] for row in rows))
    size = 0.5 + 3.5 * len(names), 3.2
    figure, panels = plt.subplots(
        1, len(names), figsize=size, layout="constrained", sharey=True, squeeze=False
    )
    for axes, name in zip(panels[0], names, strict=True):
        for device in dict.fromkeys(row["device"] for row in rows if row["experiment"] == name):
            own = [row for row in rows if row["experiment"] == name and row["device"] == device]
            own.sort(key=lambda row: row["runs"])
            runs = [row["runs"] for row in own]
            label = "CPU" if device == "cpu" else device
            (line,) = axes.plot(runs, [row["seconds"] for row in own], marker="o", label=label)
            one_by_one = [row["steps"] / single_rate(own, name, device) for row in own]
            axes.plot(runs, one_by_one, color=line.get_color(), linestyle=":", label=f"{label}, one by one")
        axes.set(xscale="log", yscale="log", xlabel="runs", title=name)
        axes.legend(frameon=False, fontsize="small")
    panels[0, 0].set_ylabel("seconds of the command")
    figure.savefig(path, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
