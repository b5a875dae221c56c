"""kCBTS on the parking problem beside its plain NumPy reference: the same plans, the same random numbers.

The reference (tests/reference/kcbts.py) is given its random numbers and the paths of its candidates; bojax
draws and generates them within the time that is measured.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_kcbts.py                 on a CPU one core; on a GPU whole episodes too
  python benchmarks/bench_kcbts.py --runs 200 1000 --episodes --json kcbts.json
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("kcbts_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--runs", type=positive, nargs="+", help="batch sizes (200; on a GPU 200 and 1000)")
    parser.add_argument("--lanes", type=positive, help="most runs at once on a device (CPU 64; GPU all)")
    parser.add_argument("--episodes", action="store_true", help="whole episodes too, as always on a GPU")
    parser.add_argument("--plans", type=positive, default=8, help="plans of the NumPy reference (8)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
