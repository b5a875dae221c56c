"""Steps of an environment and a tree search over discrete actions, beside gymnax, Gymnasium and mctx.

The environment is Gym's MountainCarContinuous with random actions; an episode that has ended is reset. The
search is SBO on parking: mctx searches the same actions with the same simulations and random rollouts to the
same horizon, but selects actions by its own rule (MuZero's). Libraries that are not installed are named and
skipped: pip install gymnasium gymnax mctx
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_libraries.py                 one core of a CPU, or a GPU
  python benchmarks/bench_libraries.py --lanes 1 1024 --json libraries.json
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("libraries_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument(
        "--lanes", type=positive, nargs="+", default=[1, 64], help="environments or plans at once (1 and 64)"
    )
    parser.add_argument("--steps", type=positive, default=1000, help="steps of an environment (1000)")
    parser.add_argument("--iterations", type=positive, default=300, help="simulations of a plan (300)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
