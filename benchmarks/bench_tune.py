"""Tuning of noisy experiments beside Optuna's TPE and random search, at equal numbers of runs or equal times.

Every method proposes points in batches of the same size and receives the same kind of score, a mean with
noise. Optuna and random search choose the point of the best score, as is usual; bojax chooses that of the
best posterior mean.

With --seconds, a search ends after the batch in which its processor time, for proposals and runs together,
exceeds this number. A first search of every method, which compiles, is not counted.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_tune.py                  a synthetic function of three settings, 20 searches
  python benchmarks/bench_tune.py --parking 3      also three searches of settings of kCBTS on parking
  python benchmarks/bench_tune.py --learning 3     also three searches of settings of EMU-Q on mountain car
  python benchmarks/bench_tune.py --rounds 60 --seconds 20 --cost 1
                                                   20 s a search, where a batch of points takes 1 s to run
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("tune_scores.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--searches", type=positive, default=20, help="searches of each method (20)")
    parser.add_argument("--rounds", type=positive, default=10, help="batches of a search at most (10)")
    parser.add_argument("--batch", type=positive, default=8, help="points of a batch (8)")
    parser.add_argument("--noise", type=float, default=0.2, help="standard deviation of a score (0.2)")
    parser.add_argument("--parking", type=int, default=0, help="searches of settings of kCBTS on parking (0)")
    parser.add_argument("--learning", type=int, default=0, help="searches of EMU-Q on mountain car (0)")
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="processor time of a search (no bound)"
    )
    parser.add_argument(
        "--cost", type=float, default=0.0, help="seconds that a batch of the synthetic function counts (0)"
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
