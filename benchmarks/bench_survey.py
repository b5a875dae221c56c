"""Seconds of the route that `bojax survey` proposes, of the plan of a mission, and of many routes at once.

How good routes are is the league's question: `bojax reproduce surveys`.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_survey.py                     5 starts, routes of length 20 and 40
  python benchmarks/bench_survey.py --starts 3 --device cpu
  python benchmarks/bench_survey.py --edges             outlines of 10 to 10,000 edges
  python benchmarks/bench_survey.py --routes 1000 --device gpu     1,000 routes of length 40 at once
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("survey_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--starts", type=positive, default=5, help="number of starts, at most 19 (5)")
    parser.add_argument(
        "--routes", type=positive, metavar="N", help="optimise N first guesses at once, in place of the above"
    )
    parser.add_argument(
        "--edges", action="store_true", help="routes of length 40 over outlines of 10 to 10,000 edges instead"
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
