"""The time of large sweeps on 1, 2, 4, ... GPUs, inline and through Ray.

Every measurement is a command `bojax sweep` in a process of its own. A command with one queue of runs
comes before those of a sweep, so that all programs are in the cache of compiled programs. The tables must
have the same bytes on every number of GPUs.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from options import positive
from scaling_chunks import ChunkWatch

SWEEPS = {"parking": (64_000, 256_000), "space-modelling": (16_000, 64_000), "mountain-car": (32_000,)}
"""Configs and their numbers of runs: multiples of `LANES`, so that the sizes share their programs."""

LANES = 4_000
"""Runs at once on a GPU."""

THESIS = "thesis"
"""`bojax reproduce all`, first with nothing cached on all GPUs."""

EXAMPLES = """\
  python benchmarks/bench_scaling.py                          1, 2, 4, ... up to all GPUs, or a small one
  python benchmarks/bench_scaling.py --only parking --runs 256000 --devices 1 --json one.json
  python benchmarks/bench_scaling.py --first 3 --devices 1    on the fourth GPU, beside other work
  python benchmarks/bench_scaling.py --launchers inline ray   the largest number of GPUs also through Ray
  python benchmarks/bench_scaling.py --device cpu --devices 1 2 --divide 1000    a small one, without GPUs
  python benchmarks/bench_scaling.py --results one.json two.json --plot speed-up.svg
"""

Row = Mapping[str, Any]


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; return 1 if tables differ between numbers of GPUs."""
    args = parse(argv)
    rows: list[Row] = [row for path in args.results for row in json.loads(path.read_text())["rows"]]
    if not args.results:
        choose_devices(args)
        with tempfile.TemporaryDirectory() as place:
            measure(args, Path(place), rows)
    elif args.json:
        save(rows, args.json)
    print_table(rows)
    if args.plot:
        plot(rows, args.plot)
    different = differing(rows)
    for name in different:
        print(f"error: {name}: tables differ between measurements", file=sys.stderr)
    return 1 if different else 0


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = argparse.ArgumentParser(
        prog=Path(__file__).name,
        description=(__doc__ or "").split("\n")[0],
        epilog=f"examples:\n{EXAMPLES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--device",
        choices=("auto", "gpu", "cpu"),
        default="auto",
        help="GPUs, or parts of a CPU (GPUs, or else small sweeps on parts of a CPU)",
    )
    parser.add_argument(
        "--devices", nargs="+", type=positive, metavar="N", help="numbers of GPUs (1, 2, 4, ..., all)"
    )
    parser.add_argument(
        "--first", type=int, default=0, metavar="INDEX", help="index of the first GPU that is used inline (0)"
    )
    names = (*SWEEPS, THESIS)
    parser.add_argument("--only", nargs="+", choices=names, default=list(SWEEPS), help="which sweeps")
    parser.add_argument("--runs", nargs="+", type=positive, metavar="N", help="numbers of runs, as above")
    parser.add_argument(
        "--launchers",
        nargs="+",
        choices=("inline", "ray"),
        default=["inline"],
        help="launchers; Ray runs the largest sweep of each config on the largest number of GPUs (inline)",
    )
    parser.add_argument(
        "--divide", type=positive, default=1, metavar="N", help="divide runs and lanes by a number (1)"
    )
    parser.add_argument(
        "--cached", action="store_true", help="leave out the first commands: all programs are cached"
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write the results to a file, or join those of --results"
    )
    parser.add_argument(
        "--results", nargs="+", type=Path, default=[], metavar="FILE", help="run nothing; use earlier results"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the speed-up")
    args = parser.parse_args(argv)
    if LANES % args.divide:
        parser.error(f"--divide: got {args.divide}; allowed: divisors of {LANES}")
    for number in args.runs or ():
        if number % (LANES // args.divide):
            parser.error(f"--runs: got {number}; allowed: multiples of {LANES // args.divide}")
    if args.first < 0 or (args.first and args.device == "cpu"):
        parser.error(f"--first: got {args.first}; allowed: the index of a GPU, from 0")
    if args.device == "cpu" and not args.devices:
        parser.error("--device cpu: name the numbers of parts with --devices")
    return args


def measure(args: argparse.Namespace, place: Path, rows: list[Row]) -> None:
    """Append a row for each measurement, and keep the file up to date."""
    numbers = sorted(args.devices)
    for name in args.only:
        sizes = [0] if name == THESIS else args.runs or [runs // args.divide for runs in SWEEPS[name]]
        first = 0 if name == THESIS else LANES // args.divide
        if not args.cached:
            number = numbers[-1] if name == THESIS else 1
            timed(args, name, first, number, "inline", place / f"{name}-first")
        for runs in sizes:
            cells = [(number, "inline") for number in numbers if "inline" in args.launchers]
            if "ray" in args.launchers and runs == sizes[-1]:
                cells.append((numbers[-1], "ray"))
            for number, launcher in cells:
                out = place / f"{name}-{runs}-{number}-{launcher}"
                rows.append(timed(args, name, runs, number, launcher, out))
                if args.json:
                    save(rows, args.json)


def save(rows: Sequence[Row], path: Path) -> None:
    """Write the rows, one a line."""
    lines = ",\n".join(json.dumps(row) for row in rows)
    path.write_text('{"benchmark": "scaling", "rows": [\n' + lines + "\n]}\n")


def choose_devices(args: argparse.Namespace) -> None:
    """Fill in what the command line leaves open, by the number of GPUs of this machine."""
    if args.device == "cpu":
        return
    count = count_gpus()
    left = count - args.first
    if count:
        args.device = "gpu"
        args.devices = args.devices or powers(max(left, 1))
        if max(args.devices) > left:
            sys.exit(
                f"error: --devices: got {max(args.devices)}; allowed: 1 to {left}, the GPUs from --first on"
            )
    elif args.device == "gpu" or args.devices:
        sys.exit("error: JAX finds no GPU; allowed: --device cpu --devices N ...")
    else:
        print(
            "no GPU: a thousandth of the runs, on one and two parts of the CPU; space modelling is left out"
        )
        args.device, args.devices = "cpu", [1, 2]
        if args.divide == 1 and not args.runs:
            args.divide = 1000
        if args.only == list(SWEEPS):
            args.only = ["parking", "mountain-car"]


def count_gpus() -> int:
    """Number of GPUs that JAX finds, in a process of its own, which gives them back."""
    code = "import jax; print(jax.device_count('gpu'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    return 0 if done.returncode else int(done.stdout)


def powers(count: int) -> list[int]:
    """The powers of two below a number, and the number."""
    return [1 << each for each in range((count - 1).bit_length())] + [count]


def timed(
    args: argparse.Namespace, name: str, runs: int, number: int, launcher: str, out: Path
) -> dict[str, Any]:
    """Run a command and describe it: seconds of all of it, spans of its chunks, hashes of its tables."""
    words = [
        sys.executable,
        "-m",
        "bojax",
        *command(name, runs, args),
        *place_on(number, launcher, out, args.first),
    ]
    parts = max(args.devices) if args.device == "cpu" else 0
    flags = f" --xla_force_host_platform_device_count={parts}" if parts else ""
    environment = os.environ | {"XLA_FLAGS": os.environ.get("XLA_FLAGS", "") + flags}
    start = time.perf_counter()
    with ChunkWatch(out) as watch:
        done = subprocess.run([*words, "--out", str(out)], env=environment, capture_output=True, text=True)
    seconds = time.perf_counter() - start
    if done.returncode > (name == THESIS):  # `reproduce` ends in 1 if a claim is not reproduced
        sys.exit(f"error: {' '.join(words)} ended in {done.returncode}: {done.stderr.strip()[-2000:]}")
    manifests = [json.loads(path.read_text()) for path in sorted(out.rglob("manifest.json"))]
    spans = watch.spans()
    row = {
        "sweep": name,
        "runs": runs or sum(manifest["runs"] * len(manifest["points"]) for manifest in manifests),
        "device": manifests[0]["device"]["kind"],
        "devices": number,
        "launcher": launcher,
        "command_seconds": round(seconds, 2),
        "chunk_seconds": max((end for _, end in spans), default=None),
        "advancing_seconds": sum(group["run_seconds"] for each in manifests for group in each["groups"]),
        "spans": spans if name != THESIS else [],
        "times": [manifest["times"] for manifest in manifests],
        "sweeps": [manifest["name"] for manifest in manifests],
        "groups": [
            {"sweep": manifest["name"], "group": group["name"], **group["times"]}
            for manifest in manifests
            for group in manifest["groups"]
        ],
        "sha256": [
            {table: hashed for table, hashed in manifest["sha256"].items() if table != "timings.parquet"}
            for manifest in manifests
        ],
    }
    print({key: row[key] for key in list(row)[:8]}, flush=True)
    return row


def command(name: str, runs: int, args: argparse.Namespace) -> list[str]:
    """The command of a sweep, and its settings."""
    if name == THESIS:
        return ["reproduce", "all"]
    lanes = f"engine.lanes_per_device={LANES // args.divide}"
    return ["sweep", sweep_file(name), "--runs", str(runs), f"engine.device={args.device}", lanes]


def sweep_file(name: str) -> str:
    """The file of a sweep of one point, that of a config."""
    path = Path(tempfile.gettempdir()) / f"bojax-scaling-{os.getuid()}-{name}.yaml"
    path.write_text(yaml.safe_dump({"base": name, "record": {"runs": 0}}))
    return str(path)


def place_on(number: int, launcher: str, out: Path, first: int = 0) -> list[str]:
    """The options that choose a number of GPUs; Ray chooses which ones by itself."""
    if launcher == "inline":
        return ["--devices", ",".join(map(str, range(first, first + number)))]
    cluster = out.with_suffix(".yaml")
    cluster.write_text(yaml.safe_dump({"workers": number}))
    return ["--launcher", "ray", "--cluster", str(cluster)]


def differing(rows: Sequence[Row]) -> list[str]:
    """The sweeps whose tables differ between rows with equal runs and devices of one kind."""
    hashes: dict[str, set[str]] = {}
    for row in rows:
        name = f"{row['sweep']}, {row['runs']:,} runs, {row['device']}"
        hashes.setdefault(name, set()).add(json.dumps(row["sha256"], sort_keys=True))
    return [name for name, found in hashes.items() if len(found) > 1]


def speed_up(rows: Sequence[Row], row: Row) -> float | None:
    """Seconds on one GPU over those of a row; None if one GPU was not measured."""
    same = ("sweep", "runs", "device")
    one = [each for each in rows if each["devices"] == 1 and all(each[key] == row[key] for key in same)]
    return one[0][measure_of(row)] / row[measure_of(row)] if one else None


def measure_of(row: Row) -> str:
    """The seconds that count: from the first chunk to the last one; of the thesis, the whole command."""
    return "command_seconds" if row["sweep"] == THESIS else "chunk_seconds"


def print_table(rows: Sequence[Row]) -> None:
    """Print the seconds and the speed-up of each measurement, in Markdown."""
    print("\n| sweep | runs | GPUs | launcher | chunks, s | command, s | speed-up | device-s |")
    print("|---|---|---|---|---|---|---|---|")
    for row in rows:
        ratio = speed_up(rows, row)
        words = [row["sweep"], f"{row['runs']:,}", str(row["devices"]), row["launcher"]]
        words += [f"{row['chunk_seconds']:.1f}", f"{row['command_seconds']:.1f}"]
        words += ["" if ratio is None else f"{ratio:.2f}", f"{row['advancing_seconds']:.1f}"]
        print("| " + " | ".join(words) + " |")


def plot(rows: Sequence[Row], path: Path) -> None:
    """Draw the speed-up against the number of GPUs, and the ideal line."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.5, 3.4), layout="constrained")
    counts = sorted({row["devices"] for row in rows})
    axes.plot(counts, counts, color="gray", linestyle=":", label="ideal")
    cards = list(dict.fromkeys(row["device"] for row in rows))
    for card, sweep, runs, launcher in dict.fromkeys(map(_curve_of, rows)):
        own = [row for row in rows if _curve_of(row) == (card, sweep, runs, launcher)]
        points = sorted((row["devices"], ratio) for row in own if (ratio := speed_up(rows, row)))
        words = [f"{sweep}, {runs:,} runs", *(["Ray"] if launcher == "ray" else [])]
        words += [card] if len(cards) > 1 else []
        if points:
            style = (0, (1, 1 + 2 * cards.index(card))) if cards.index(card) else "-"
            marker = "x" if launcher == "ray" else "o"
            axes.plot(*zip(*points, strict=True), marker=marker, linestyle=style, label=", ".join(words))
    label = f"devices ({cards[0]})" if len(cards) == 1 else "devices"
    axes.set(xlabel=label, ylabel="times as fast as one", xticks=counts)
    figure.legend(loc="outside right upper", frameon=False, fontsize="small")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _curve_of(row: Row) -> tuple[str, str, int, str]:
    return row["device"], row["sweep"], row["runs"], row["launcher"]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
