"""Physics of the robots in a compiled program, compared with C MuJoCo's rollout on the same cores.

Controls are random and change with every action. C MuJoCo steps the same model with the same solver settings.
"""

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from isolated import run_isolated
from options import make_parser, positive

INTEGRATORS = ("euler", "rk4", "implicitfast")
IMPLS = {"jax": "MJX in JAX", "pallas": "MJX as a kernel", "c": "C MuJoCo"}
"""Implementations of the physics, and their names."""
ROBOTS = ("hopper", "reacher", "jaco", "wheeled-robot", "quadrotor", "lunar-lander")

EXAMPLES = """\
  python benchmarks/bench_robots.py                                   all robots
  python benchmarks/bench_robots.py --robots hopper --lanes 256 2048  lanes at once
  python benchmarks/bench_robots.py --robots hopper --settings 4/8/rk4 3/6/euler
  python benchmarks/bench_robots.py --robots hopper --impls pallas    one implementation
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    return run_isolated(Path(__file__).with_name("robots_timings.py"), argv, args.device, args.cores)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = make_parser(__file__, __doc__, EXAMPLES)
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=ROBOTS, help="which robots (all)")
    parser.add_argument(
        "--lanes", nargs="+", type=positive, help="robots at once (16 64 on a CPU, 256 2048 on a GPU)"
    )
    parser.add_argument(
        "--settings",
        nargs="+",
        type=solver,
        default=["model"],
        metavar="I/L/INTEGRATOR",
        help="solver iterations, line search iterations and integrator; or model, for those of the model",
    )
    parser.add_argument(
        "--impls",
        nargs="+",
        choices=IMPLS,
        help="implementations of the physics (jax and c; on a GPU pallas too)",
    )
    parser.add_argument("--steps", type=positive, default=20, help="actions of a run (20)")
    parser.add_argument("--no-peer", action="store_true", help="do not time C MuJoCo")
    return parser.parse_args(argv)


def solver(text: str) -> str:
    """Solver settings from the command line, in lower case: `model`, or such as `4/8/rk4`."""
    setting, count = text.lower(), "[1-9][0-9]*"
    if not re.fullmatch(f"model|{count}/{count}/({'|'.join(INTEGRATORS)})", setting):
        allowed = ", ".join(INTEGRATORS)
        raise argparse.ArgumentTypeError(
            f"got {text}; allowed: model or I/L/INTEGRATOR, such as 4/8/rk4, with integrators {allowed}"
        )
    return setting


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
