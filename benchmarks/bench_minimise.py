"""Simple regret of bojax.minimise beside BoTorch, Optuna, bayes_opt, scikit-optimize and random search.

All methods have the same number of evaluations of eight standard functions and two with choices and integers.
BoTorch maximises qLogEI (Ament et al., 2023) with its default process, for mixed spaces over one-hot choices;
bayes_opt has neither choices nor integers, and is left out there. The table has the median of the simple
regret, the difference between the best value found and the minimum, and its 95% bootstrap interval.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_minimise.py                          20 seeds of 50 evaluations
  python benchmarks/bench_minimise.py --seeds 3 --functions branin mixed-ackley
  python benchmarks/bench_minimise.py --searches searches.jsonl    goes on after an interruption
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("minimise_regrets.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--seeds", type=positive, default=20, help="searches of each method (20)")
    parser.add_argument("--evaluations", type=positive, default=50, help="evaluations of a search (50)")
    parser.add_argument("--functions", nargs="+", metavar="NAME", help="some of the functions (all)")
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="some of the methods (all installed)")
    parser.add_argument(
        "--searches", type=Path, metavar="FILE", help="keep each search there; those it has are not run again"
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
