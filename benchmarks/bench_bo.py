"""Bayesian optimisation of Branin's function, compared with bayes_opt, scikit-optimize and BoTorch.

Every run starts with a few random points. bayes_opt and scikit-optimize relearn their hyper-parameters at
every iteration, which is their default. BoTorch and bojax keep the given hyper-parameters, except in the rows
"that relearns".
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_bo.py                 30 evaluations; bojax in one run and in 200 at once
  python benchmarks/bench_bo.py --runs 200 1000 --json bo.json
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("bo_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--evaluations", type=positive, default=30, help="evaluations of a run (30)")
    parser.add_argument("--initial", type=positive, default=5, help="random initial points of a run (5)")
    parser.add_argument("--runs", type=positive, nargs="+", default=[200], help="batch sizes of bojax (200)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
