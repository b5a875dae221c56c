"""Paths of SGP-Tools 2.0.7 on the areas of the league of surveys, which are stored for it.

    python3 -m venv sgp && sgp/bin/pip install sgptools==2.0.7
    python benchmarks/sgptools_paths.py --sgptools sgp/bin/python --workers 2

For each area, length and start, `sgptools_worker.py` plans a path between points of the area, in an
environment of its own. SGP-Tools knows no obstacles: a leg that leaves the area is led along the shortest way
in it. If the path is then too long, it is planned once more with a budget that is smaller by as much. Both
are cut at the length, and the one after which the league's process expects the smaller error is stored.
"""

import argparse
import json
import queue
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bojax.results.store import write_json
from bojax.surveys.information import PointErrors
from bojax.surveys.lawnmower import Ground, joined
from bojax.surveys.league.cells import COVERING, LENGTHS
from bojax.surveys.league.fields import LENGTHSCALE, MODEL, NOISE_VARIANCE, VARIANCE, Field, league
from bojax.surveys.league.routes import PEERS, SPACING, peers, start_of, surveyed
from bojax.surveys.polylines import Waypoints, length_of, points_along
from bojax.surveys.route import fitted, spread_points

ROUNDS, ENOUGH = 2, 1.01
"""Most budgets that are tried, and the share of the length up to which a path needs no smaller one."""

LEG = 2
"""Length for each waypoint."""

POINTS, CANDIDATES = 0.4, 0.1
"""Spacing of the points of the area that are to be mapped, and of those that may be waypoints."""

Workers = queue.SimpleQueue[subprocess.Popen[str]]


def main(argv: Sequence[str]) -> int:
    """Plan all paths, and store them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sgptools", required=True, metavar="PYTHON", help="Python that has SGP-Tools")
    places = {field.place: field for field in league()}
    parser.add_argument("--places", nargs="+", choices=places, default=list(places), help="areas (all)")
    lengths = (*LENGTHS, COVERING)
    parser.add_argument("--lengths", nargs="+", type=int, choices=lengths, default=lengths, help="(all)")
    parser.add_argument("--workers", type=int, default=1, help="processes of SGP-Tools (1)")
    args = parser.parse_args(argv)
    jax.config.update("jax_enable_x64", True)
    workers: Workers = queue.SimpleQueue()
    running = [_worker(args.sgptools) for _ in range(args.workers)]
    for worker in running:
        workers.put(worker)
    with ThreadPoolExecutor(args.workers) as pool:
        for place in args.places:
            for length in args.lengths:
                starts = range(len(peers()["starts"]))
                paths = list(pool.map(partial(_path, places[place], length, workers), starts))
                stored = json.loads(PEERS.read_text())
                stored[f"sgptools-{place}-{length}"] = [np.round(path, 4).tolist() for path in paths]
                write_json(PEERS, stored, indent=None)
    for worker in running:
        worker.terminate()
    return 0


def _worker(python: str) -> subprocess.Popen[str]:
    command = [python, str(Path(__file__).with_name("sgptools_worker.py"))]
    return subprocess.Popen(
        command, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )


def _path(field: Field, length: int, workers: Workers, index: int) -> Waypoints:
    """The path of one area, length and start."""
    part = surveyed(field.area)
    transfers, start = Ground.of(part).transfers, start_of(part, index)
    errors = PointErrors.of(MODEL.belief(), jnp.asarray(spread_points(part, 400)))
    request = {
        "points": part.grid(POINTS).tolist(),
        "candidates": part.grid(CANDIDATES).tolist(),
        "start": start.tolist(),
        "waypoints": length // LEG,
        "seed": index,
        "lengthscale": LENGTHSCALE,
        "variance": VARIANCE,
        "noise_variance": NOISE_VARIANCE,
    }
    budget, found = float(length), []
    for _ in range(ROUNDS):
        answer, seconds = _answer(workers, {**request, "budget": budget})
        path = joined([answer], transfers)
        cut = fitted(path, length, None, None)
        found.append((_error(errors, cut, length), length_of(path), cut, seconds))
        if length_of(path) <= ENOUGH * length:
            break
        budget *= length / length_of(path)
    best = min(found, key=lambda each: each[0])
    tried = ", ".join(f"{error:.4f} ({driven:.1f}) in {s:.1f} CPU s" for error, driven, _, s in found)
    print(f"{field.place} {length} {index}: {tried}", flush=True)
    return best[2]


def _answer(workers: Workers, request: dict[str, Any]) -> tuple[Waypoints, float]:
    """The path of a free worker, and the CPU seconds that it took.

    Raises:
        RuntimeError: It has ended.
    """
    worker = workers.get()
    assert worker.stdin and worker.stdout
    worker.stdin.write(json.dumps(request) + "\n")
    worker.stdin.flush()
    answer = worker.stdout.readline()
    workers.put(worker)
    if not answer:
        raise RuntimeError("SGP-Tools has ended; sgptools_worker.py alone shows why")
    found = json.loads(answer)
    return np.array(found["path"]), found["seconds"]


def _error(errors: PointErrors, route: Waypoints, length: float) -> float:
    """The error that the process expects after a route."""
    distances = SPACING * np.arange(1, round(length / SPACING) + 1)
    taken = distances <= length_of(route) * (1.0 + 1e-9)
    return float(errors.after(jnp.asarray(points_along(route, distances)), jnp.asarray(taken)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
