"""Seconds and memory against size: action dimensions, features, runs, iterations, observations.

Each size is measured in a process of its own. Its seconds are CPU seconds on one core, and wall time on more;
compilation is apart. Its memory is the largest resident set of the process beyond that after the imports. The
last columns are local exponents, the slopes between two sizes on logarithmic axes: 1 for a cost that grows
in proportion. A curve that bends upwards has exponents that rise.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

CURVES = (
    "bo-dimensions",
    "emu-q-dimensions",
    "pft-dimensions",
    "emu-q-features",
    "refit-features",
    "runs",
    "cbts-iterations",
    "pft-iterations",
    "pomcpow-iterations",
    "field-observations",
    "gp-observations",
    "survey-observations",
    "survey-stream",
)

EXAMPLES = """\
  python benchmarks/bench_sizes.py                        all curves on one core of a CPU
  python benchmarks/bench_sizes.py --only runs --json runs.json
  python benchmarks/bench_sizes.py --largest 1000         leave out larger sizes
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("sizes_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.set_defaults(device="cpu", repeats=3)
    parser.add_argument(
        "--only", nargs="+", choices=CURVES, default=CURVES, metavar="CURVE", help=f"of {', '.join(CURVES)}"
    )
    parser.add_argument("--largest", type=positive, default=10**6, help="largest size of every curve")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
