"""EMU-Q, compared with the author's published NumPy code: online steps, and the refit after an episode.

Both use 15 candidate actions and 10 samples of the exploration reward. The online steps of bojax include the
environment, goal-only mountain car; those of RFF-Q, also with 15 candidates, stand beside them. The refit is
timed on given transitions with rewards, with the same number of sweeps in both; the direct fit solves the
equations of as many policies.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

EXAMPLES = """\
  python benchmarks/bench_emu_q.py                        300 features, on a CPU core or on a GPU
  python benchmarks/bench_emu_q.py --features 500 --runs 1000 --json emu-q.json
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("emu_q_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--features", type=positive, default=300, help="random Fourier features (300)")
    parser.add_argument("--runs", type=positive, default=200, help="runs at once on a GPU (200)")
    parser.add_argument("--lanes", type=positive, default=8, help="runs at once on a CPU (8)")
    parser.add_argument("--steps", type=positive, default=500, help="steps of an episode (500)")
    parser.add_argument("--transitions", type=positive, default=2000, help="transitions of a refit (2000)")
    parser.add_argument("--sweeps", type=positive, default=30, help="sweeps of a refit, for Q and for U (30)")
    parser.add_argument("--dtype", choices=("float32", "float64"), default="float32", help="(float32)")
    parser.add_argument("--no-peer", action="store_true", help="do not time the NumPy version")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
