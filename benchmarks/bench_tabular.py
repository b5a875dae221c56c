"""Episodes of tabular Q-learning on taxi, beside Gymnasium's Taxi with Q-learning in NumPy.

An episode is one of training, which test episodes may follow. On an NVIDIA GPU it is a kernel; beside it
stands the program of XLA that it replaces. Gymnasium is skipped if it is not installed.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_tabular.py                   one core of a CPU, or a GPU
  python benchmarks/bench_tabular.py --lanes 200 1000 --tests 5 --json tabular.json
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("tabular_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--lanes", type=positive, nargs="+", default=[200], help="runs at once (200)")
    parser.add_argument("--steps", type=positive, default=1000, help="maximum steps of an episode (1000)")
    parser.add_argument("--tests", type=int, default=0, help="test episodes after each episode (0)")
    parser.add_argument("--dtype", choices=("float32", "float64"), default="float64", help="(float64)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
