"""kCBTS on a field, compared with a NumPy reference that builds the same trees from the same random numbers.

Plans have 192 observations with a capacity of 200, depth 3, 20 actions per node, 8 samples per action and
300 iterations, in float64. The reference (tests/reference/monitoring.py) factorises the covariance of all
real and imagined data in two ways: for each belief, after every simulated path as in Algorithm 2, or on
demand, only for the beliefs that it uses later. The reference is given its random numbers and the paths of
its candidates; the time of bojax includes drawing and generating them.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_field.py                 one core of a CPU, or a GPU and its memory
  python benchmarks/bench_field.py --runs 200 1000 --objectives gradient --json field.json
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("field_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--runs", type=positive, nargs="+", help="batch sizes (200; on a GPU 200 and 1000)")
    parser.add_argument("--lanes", type=positive, help="maximum runs at once on a device (CPU 8; GPU all)")
    parser.add_argument("--plans", type=positive, default=2, help="plans of the NumPy reference (2)")
    parser.add_argument(
        "--objectives",
        nargs="+",
        choices=("value", "gradient"),
        default=("value", "gradient"),
        help="planning objectives (both)",
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
