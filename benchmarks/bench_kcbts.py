"""kCBTS on the parking problem beside its plain NumPy reference: the same plans, the same random numbers.

The reference (tests/reference/kcbts.py) is given its random numbers and the paths of its candidates; bojax
draws and generates them within the time that is measured.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated

EXAMPLES = """\
examples:
  python benchmarks/bench_kcbts.py                 on a CPU one core; on a GPU whole episodes too
  python benchmarks/bench_kcbts.py --runs 200 1000 --episodes --json kcbts.json
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("kcbts_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = argparse.ArgumentParser(
        prog="bench_kcbts.py",
        description=(__doc__ or "").split("\n")[0],
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto", help="where bojax runs")
    parser.add_argument("--cores", type=_positive, default=1, help="cores on a CPU (1)")
    parser.add_argument("--runs", type=_positive, nargs="+", help="batch sizes (200; on a GPU 200 and 1000)")
    parser.add_argument("--lanes", type=_positive, help="most runs at once on a device (CPU 64; GPU all)")
    parser.add_argument("--episodes", action="store_true", help="whole episodes too, as always on a GPU")
    parser.add_argument("--plans", type=_positive, default=8, help="plans of the NumPy reference (8)")
    parser.add_argument("--repeats", type=_positive, default=7, help="repeats: the median counts (7)")
    parser.add_argument("--seed", type=int, default=0, help="seed of starts and plans (0)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep the results in a file")
    return parser.parse_args(argv)


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value}: has to be at least 1")
    return value


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
