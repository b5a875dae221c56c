"""Tuning of noisy experiments, compared with Optuna's TPE and with random search at equal numbers of runs.

Every method proposes points in batches of the same size and receives the same kind of score, a mean with
noise. Optuna and random search choose the point of the best score, as is usual; bojax chooses that of the
best posterior mean.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_tune.py                  a synthetic function of three settings, 20 searches
  python benchmarks/bench_tune.py --parking 3      also three searches of two settings of kCBTS on parking
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("tune_scores.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--searches", type=positive, default=20, help="searches of each method (20)")
    parser.add_argument("--rounds", type=positive, default=10, help="batches of a search (10)")
    parser.add_argument("--batch", type=positive, default=8, help="points of a batch (8)")
    parser.add_argument("--noise", type=float, default=0.2, help="standard deviation of a score (0.2)")
    parser.add_argument("--parking", type=int, default=0, help="searches of settings of kCBTS on parking (0)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
