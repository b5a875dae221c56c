"""kCBTS on a field beside a plain NumPy tree that refits its beliefs: the same trees and random numbers.

192 observations of room for 200, depth 3, 20 actions a node, 8 samples an action, 300 iterations, float64.
The reference (tests/reference/monitoring.py) factors the covariance of all data, real and imagined, after
every simulated path, as Algorithm 2 updates its belief; or, smarter, only the beliefs that it asks later. It
is given its random numbers and the paths of its candidates; bojax draws and generates them within the time
that is measured.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_field.py                 on a CPU one core; on a GPU its memory too
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
    parser.add_argument("--lanes", type=positive, help="most runs at once on a device (CPU 8; GPU all)")
    parser.add_argument("--plans", type=positive, default=2, help="plans of the NumPy reference (2)")
    parser.add_argument(
        "--objectives",
        nargs="+",
        choices=("value", "gradient"),
        default=("value", "gradient"),
        help="what a sample is worth (both)",
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
