"""The timings of bench_pomdp.py, run in a process with its own cores."""

import itertools
import json
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from bench_pomdp import parse
from peers import installed, print_ratios
from timing import Row, median_seconds, on_gpu, print_rows, time_runs, write_record

from bojax.engine.build import build
from bojax.planning.settings import PFTDPW, POMCPOW, VOMCPOW
from bojax.problems import particles
from bojax.problems.pomdp.settings import VdpTag

STORED = Path(__file__).with_name("results") / "2026-11-26-pomdpplanners-cpu.json"
"""What `pomdpplanners_vdp_tag.py` measured in an environment of its own."""

NUM_PARTICLES = 1000
DEPTH = 10
LANES_ON_CPU = 32
SOLVERS = {"pomcpow": POMCPOW, "vomcpow": VOMCPOW, "pft-dpw": PFTDPW}


def numba_plans(iterations: int) -> Callable[[int], Any]:
    """A plan of the Numba loops for the belief of a seed."""
    from pomcpow_numba import plan

    belief = np.zeros((NUM_PARTICLES, 4))
    belief[:, 2:] = np.random.default_rng(0).uniform(-4.0, 4.0, (NUM_PARTICLES, 2))
    plan(0, belief, 10, DEPTH)  # compiles
    return lambda seed: plan(seed, belief, iterations, DEPTH)


def pomdp_py_plans(iterations: int) -> Callable[[int], Any]:
    """A plan of POMCP of pomdp-py for the same belief."""
    from pomdp_py_vdp_tag import planner

    return planner(iterations, DEPTH, NUM_PARTICLES)


def main(argv: list[str]) -> int:
    """Time the peers, then bojax."""
    args = parse(argv)
    problem = build(VdpTag(), "float32")
    peers = installed(
        {"Numba": ("numba", lambda: numba_plans), "pomdp-py": ("pomdp_py", lambda: pomdp_py_plans)}
    )
    rows = []
    for name, plans in peers.items():
        plan = plans(args.iterations)
        seeds = itertools.count(1)
        seconds = median_seconds(lambda plan=plan, seeds=seeds: plan(next(seeds)), args.repeats)
        solver = {"Numba": "POMCPOW", "pomdp-py": "POMCP"}[name]
        rows.append(Row(f"{name}, {solver}", 1, seconds, args.iterations))
    for kind, trees in itertools.product(args.planners, args.trees):
        settings = SOLVERS[kind](iterations=args.iterations, depth=DEPTH, trees=trees)
        planner = build(settings, "float32")

        def plan(run, planner=planner):
            key_belief, key_plan = jax.random.split(jax.random.fold_in(jax.random.key(args.seed), run))
            belief = particles.initial(problem, key_belief, NUM_PARTICLES)
            made = planner.plan(key_plan, problem, belief)
            return made.action, made.value

        name = f"bojax, {kind}" if trees == 1 else f"bojax, {kind}, {trees} trees"
        for runs in args.runs:
            lanes = jax.device_count() * (args.lanes or (runs if on_gpu() else LANES_ON_CPU))
            row = time_runs(name, plan, runs, lanes, trees * args.iterations, args.repeats)
            rows.append(row)
            print(f"{row.what}, {runs} runs: {_memory()}", flush=True)
    print_rows("VDP Tag", "iterations", rows, rows[0].what)
    print_ratios(rows, {})
    print(stored())
    if args.json:
        described = {"iterations": args.iterations, "depth": DEPTH, "num_particles": NUM_PARTICLES}
        write_record(args.json, "pomdp", "iterations", rows, described)
    return 0


def stored() -> str:
    """The stored rates of a peer that is not measured here, as a line."""
    record = json.loads(STORED.read_text())
    rates = ", ".join(f"{solver} {rate:,}" for solver, rate in record["iterations_per_s"].items())
    of = f"{record['package']} {record['version']}, measured on {record['date']}, one core"
    return f"{of}: {rates} iterations/s (pomdpplanners_vdp_tag.py)"


def _memory() -> str:
    """Peak memory so far, of a device, or of this process on a CPU."""
    found = [device.memory_stats() for device in jax.devices()] if on_gpu() else []
    peak = max((stats["peak_bytes_in_use"] for stats in found if stats), default=0)
    if peak:
        return f"peak memory of a device so far {peak / 1e9:.2f} GB"
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return f"peak memory of the process so far {own / 1e9:.2f} GB"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
