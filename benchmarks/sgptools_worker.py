"""Paths of SGP-Tools 2.0.7, in JSON: requests on standard input, paths and CPU seconds on standard output.

`sgptools_paths.py` starts it with the Python of an environment that has SGP-Tools and not bojax.
"""

import json
import os
import sys
import time
from typing import Any

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import gpflow  # pyright: ignore[reportMissingImports]
import numpy as np
import tensorflow as tf  # pyright: ignore[reportMissingModuleSource, reportMissingImports]
from sgptools.core.transformations import IPPTransform  # pyright: ignore[reportMissingImports]
from sgptools.methods import ContinuousSGP  # pyright: ignore[reportMissingImports]
from sgptools.utils.misc import (  # pyright: ignore[reportMissingImports]
    get_inducing_pts,
    project_waypoints,
)
from sgptools.utils.tsp import run_tsp  # pyright: ignore[reportMissingImports]

SAMPLES = 10
"""Samples of each leg, at every 0.2 units of a leg of 2."""

WEIGHT = 2000.0
"""Of the length beyond the budget: with the 500 of its tutorial, paths were longer than it."""

STEPS = 1000
"""Of L-BFGS, as in its tutorial."""


def main() -> None:
    """Answer every request."""
    tf.config.threading.set_intra_op_parallelism_threads(1)
    tf.config.threading.set_inter_op_parallelism_threads(1)
    answers, sys.stdout = sys.stdout, sys.stderr  # it prints warnings
    for line in sys.stdin:
        begin = time.process_time()
        path = path_of(**json.loads(line))
        seconds = time.process_time() - begin
        print(json.dumps({"path": path, "seconds": seconds}), file=answers, flush=True)


def path_of(
    points: list[Any],
    candidates: list[Any],
    start: list[float],
    waypoints: int,
    budget: float,
    seed: int,
    lengthscale: float,
    variance: float,
    noise_variance: float,
) -> list[Any]:
    """Waypoints of a path from `start` that maps `points`, each one of `candidates`, as in its tutorial.

    It begins as a tour of the centres of clusters of the points. The budget is soft.
    """
    np.random.seed(seed)
    tf.random.set_seed(seed)
    first, grid = np.array([start]), np.array(points)
    centres = get_inducing_pts(grid, waypoints - 1, seed=seed)
    (tour,), _ = run_tsp(centres, start_nodes=first)
    transform = IPPTransform(
        sampling_rate=SAMPLES, distance_budget=budget, constraint_weight=WEIGHT, Xu_fixed=first[None]
    )
    kernel = gpflow.kernels.Matern52(variance=variance, lengthscales=lengthscale)
    method = ContinuousSGP(waypoints, grid, kernel, noise_variance, transform, X_init=tour)
    (path,) = method.optimize(max_steps=STEPS)
    return np.concatenate([first, project_waypoints(path[1:], np.array(candidates))]).tolist()


if __name__ == "__main__":
    main()
