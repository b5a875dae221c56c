"""kCBTS on the parking problem, compared with a NumPy reference on the same plans and random numbers.

The reference (tests/reference/kcbts.py) is given its random numbers and the paths of its candidates; the time
of bojax includes drawing and generating them.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_kcbts.py                 one core of a CPU, or a GPU, also with whole episodes
  python benchmarks/bench_kcbts.py --runs 200 1000 --episodes --json kcbts.json
  python benchmarks/bench_kcbts.py --compare-xla   on a GPU: also the search as a program of XLA
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("kcbts_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--runs", type=positive, nargs="+", help="batch sizes (200; on a GPU 200 and 1000)")
    parser.add_argument("--lanes", type=positive, help="maximum runs at once on a device (CPU 64; GPU all)")
    parser.add_argument("--episodes", action="store_true", help="also time whole episodes (always on a GPU)")
    parser.add_argument(
        "--compare-xla",
        action="store_true",
        help="on a GPU: also time the search as a program of XLA, and compare the plans",
    )
    parser.add_argument("--plans", type=positive, default=8, help="plans of the NumPy reference (8)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
