"""Errors of maps along routes of equal length: bojax beside others, on real and synthetic fields.

The others are the best lawnmower, SGP-Tools, a myopic and a random route. Three of six real fields need the
package iris-sample-data, and the extra geo.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_survey.py                     10 starts, routes of length 20 and 40
  python benchmarks/bench_survey.py --starts 3 --budgets 20
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("survey_errors.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--starts", type=positive, default=10, help="number of starts, at most 20 (10)")
    parser.add_argument(
        "--budgets", type=int, nargs="+", choices=(20, 40), default=[20, 40], help="lengths (20 40)"
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
