"""Belief searches on VDP Tag with the published constants, beside other programs on one core.

Peers: the published POMCPOW as loops compiled by Numba, and POMCP of pomdp-py, which needs finite actions and
observations (50 actions, readings rounded to .2, as published). All plan for the initial belief. Peers that
are not installed are named and skipped. POMDPPlanners needs an environment of its own: its stored rates are
printed, which `pomdpplanners_vdp_tag.py` measured.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_pomdp.py                 one core of a CPU, or a GPU
  python benchmarks/bench_pomdp.py --runs 1 32 --planners pomcpow --iterations 300
  python benchmarks/bench_pomdp.py --runs 1 --trees 1 16 64
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("pomdp_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument(
        "--runs", type=positive, nargs="+", default=[1, 32, 1000], help="batch sizes (1, 32 and 1000)"
    )
    parser.add_argument("--lanes", type=positive, help="maximum runs at once on a device (CPU 32; GPU all)")
    parser.add_argument("--iterations", type=positive, default=1000, help="simulations of a plan (1000)")
    parser.add_argument(
        "--trees", type=positive, nargs="+", default=[1], help="independent trees of a plan (1)"
    )
    parser.add_argument(
        "--planners",
        nargs="+",
        choices=("pomcpow", "vomcpow", "pft-dpw"),
        default=("pomcpow", "pft-dpw"),
        help="planners of bojax (pomcpow and pft-dpw)",
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
