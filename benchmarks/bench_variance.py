"""Accuracy of the predictive variance of EMU-Q's model after many clustered steps, against a float64 solve.

The steps come from a few clusters of the state-action space, one cluster after the other, as those of a
learner do. The reference computes the covariance of all steps at once, in float64 by NumPy.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_variance.py                    20,000 steps, alpha 0.1, 0.01 and 0.001
  python benchmarks/bench_variance.py --features 500 --steps 50000
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("variance_errors.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--features", type=positive, default=300, help="random Fourier features (300)")
    parser.add_argument("--steps", type=positive, default=20_000, help="steps (20,000)")
    parser.add_argument("--clusters", type=positive, default=5, help="number of clusters of the steps (5)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
