"""The time of an experiment against its number of runs, beside the same steps in runs one after the other.

Every experiment is a command `bojax run` in a process of its own, after one that fills the cache of compiled
programs. The peer is a single run: its steps per second. (Runs of a learner differ in length.)
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from options import make_parser, positive

EXPERIMENTS = {
    "parking": ["parking"],
    "mountain-car": ["mountain-car"],
}
"""A planning experiment, 15 plans of kCBTS a run, and a learning one, EMU-Q up to its first success."""

EXAMPLES = """\
  python benchmarks/bench_runs.py                            1 to 1,000 runs
  python benchmarks/bench_runs.py --most 100000 --seconds 300 --json runs.json --plot runs.svg
"""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    numbers = [10**power for power in range(len(str(args.most))) if 10**power <= args.most]
    rows = []
    with tempfile.TemporaryDirectory() as place:
        for name, command in EXPERIMENTS.items():
            for number in numbers:
                if rows and rows[-1]["experiment"] == name and 10 * rows[-1]["advancing"] > args.seconds:
                    break
                timed(command, number, args, Path(place) / f"{name}-{number}-first")
                rows.append(
                    {"experiment": name} | timed(command, number, args, Path(place) / f"{name}-{number}")
                )
                print(json.dumps(rows[-1]), flush=True)
    print_table(rows)
    if args.json:
        args.json.write_text(json.dumps({"benchmark": "runs", "rows": rows}, indent=1) + "\n")
    if args.plot:
        plot(rows, args.plot)
    return 0


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--most", type=positive, default=1000, help="largest number of runs (1000)")
    parser.add_argument(
        "--seconds",
        type=positive,
        default=120,
        help="leave out numbers of runs that are expected to take longer (120)",
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the curves")
    return parser.parse_args(argv)


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
        ratio = rate / single_rate(rows, row["experiment"])
        numbers = f"{row['seconds']:.1f}", f"{row['advancing']:.3f}", f"{rate:,.0f}", f"{ratio:,.1f}"
        table.add_row(row["experiment"], f"{row['runs']:,}", *numbers)
    Console().print(table)


def single_rate(rows: Sequence[Mapping[str, Any]], experiment: str) -> float:
    """Steps per second of a single run."""
    one = next(row for row in rows if row["experiment"] == experiment)
    return one["steps"] / one["advancing"]


def plot(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw the seconds against the number of runs, on logarithmic axes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
    for name in EXPERIMENTS:
        own = [row for row in rows if row["experiment"] == name]
        runs = [row["runs"] for row in own]
        (line,) = axes.plot(runs, [row["seconds"] for row in own], marker="o", label=f"{name}, command")
        one_by_one = [row["steps"] / single_rate(rows, name) for row in own]
        axes.plot(runs, one_by_one, color=line.get_color(), linestyle=":", label=f"{name}, one by one")
    axes.set(xscale="log", yscale="log", xlabel="runs", ylabel="seconds", title=rows[0]["device"])
    axes.legend(frameon=False, fontsize="small")
    figure.savefig(path)
    plt.close(figure)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
