"""Direct refits of EMU-Q on transitions of real runs: seconds, and errors against NumPy in float64.

The runs learn the lunar lander (500 features) and cartpole swing-up (300 features). Their states before a
refit are recorded on a CPU first, in several minutes, and are read from --states later. A lane refits one of
these states; the solutions are compared with policy iteration in plain NumPy, from the same means.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import REPOSITORY, run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_refit.py --record                      record the states, on a CPU
  python benchmarks/bench_refit.py                               1, 45 and 200 lanes on a GPU, 1 on a CPU core
  python benchmarks/bench_refit.py --lanes 1 8 --sets lunar-lander-late
  python benchmarks/bench_refit.py --episodes 60 --lanes 200     whole episodes, refits included
"""
SETS = {
    "lunar-lander-early": ("lunar-lander", 500, 4),
    "lunar-lander-late": ("lunar-lander", 500, 24),
    "cartpole-swing-up-early": ("cartpole-swing-up", 300, 3),
    "cartpole-swing-up-late": ("cartpole-swing-up", 300, 10),
}
"""Domain, number of features, and the episode whose refit is measured."""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    if args.record and args.episodes:
        print("error: --record and --episodes: allowed: one of them", file=sys.stderr)
        return 2
    device = "cpu" if args.record else args.device
    missing = [name for name in args.sets if not (args.states / f"{name}.npz").exists()]
    if missing and not args.record and not args.episodes:
        print(f"error: no states of {', '.join(missing)} in {args.states}: add --record", file=sys.stderr)
        return 2
    return run_isolated(Path(__file__).with_name("refit_timings.py"), argv, device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    states = REPOSITORY / "results" / "refit-states"
    parser.add_argument("--states", type=Path, default=states, help="folder (results/refit-states)")
    parser.add_argument("--record", action="store_true", help="record the states in place of a measurement")
    parser.add_argument("--runs", type=positive, default=4, help="runs that are recorded (4)")
    parser.add_argument("--lanes", type=positive, nargs="+", help="refits at once (1 45 200; 1 on a CPU)")
    parser.add_argument("--sets", choices=SETS, nargs="+", default=list(SETS), help="recorded states (all)")
    parser.add_argument("--episodes", type=positive, help="time this many whole episodes instead")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
