"""Fit and prediction of Gaussian processes, beside scikit-learn, BoTorch, tinygp, GPJax and JAX.

Every process has its own data and lengthscale; the hyper-parameters are given and not learned. Variances are
those of the noise-free function.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_gp.py                 200 processes of 200 points on a CPU core, or on a GPU
  python benchmarks/bench_gp.py --points 50 --json gp.json
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("gp_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--processes", type=positive, default=200, help="Gaussian processes (200)")
    parser.add_argument("--points", type=positive, default=200, help="observations of each (200)")
    parser.add_argument("--queries", type=positive, default=100, help="points to predict (100)")
    parser.add_argument("--dims", type=positive, default=2, help="dimensions of the inputs (2)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
