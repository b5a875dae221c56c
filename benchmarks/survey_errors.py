"""The routes and maps of bench_survey.py, run in a process with its own cores.

Two fields that Matplotlib ships, on 10 x 10 units and standardised: a window of a digital elevation model,
and one of a bathymetry. A sample every 0.2 along a route, with noise of standard deviation 0.05. One Gaussian
process, whose hyper-parameters were fitted to points beside the first window, maps what every route measures.
The routes of SGP-Tools 2.0.7 (ContinuousSGP) and of the lawnmower are stored in `data/survey_peers.json`.
"""

import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.cbook
import numpy as np
from bench_survey import parse
from rich.console import Console
from rich.table import Table
from scipy.interpolate import RegularGridInterpolator

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.surveys.area import Area
from bojax.surveys.information import samples_along
from bojax.surveys.route import plan_route

SPACING, NOISE, NOISE_VARIANCE = 0.2, 0.05, 0.0089
MEAN, DEVIATION = 636.74, 209.72
"""Of the heights beside the window, m."""

Field = Callable[[np.ndarray], np.ndarray]


def fields() -> dict[str, Field]:
    """Standardised heights at points `[N, 2]`."""
    heights = _shipped("jacksboro_fault_dem.npz", "elevation")
    depths = _shipped("topobathy.npz", "topo")[:30, :30]
    return {
        "elevation": _field((heights[120:228, 150:284][::-1] - MEAN) / DEVIATION),
        "bathymetry": _field((depths - depths.mean()) / depths.std()),
    }


def _shipped(file: str, name: str) -> np.ndarray:
    archive: Any = matplotlib.cbook.get_sample_data(file)
    return archive[name].astype(float)


def _field(values: np.ndarray) -> Field:
    rows, columns = (np.linspace(0.0, 10.0, size) for size in values.shape)
    interpolate = RegularGridInterpolator((rows, columns), values)
    return lambda points: interpolate(np.clip(points[:, ::-1], 0.0, 10.0))


def main(argv: list[str]) -> int:
    """Plan the routes, map the fields, and print the errors."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    peers = json.loads((Path(__file__).parent / "data" / "survey_peers.json").read_text())
    kernel = Scaled(Matern52(jnp.asarray(1.160)), jnp.asarray(0.807))
    prior = GaussianProcess.prior(kernel, NOISE_VARIANCE, 0, 2)
    axis = np.linspace(0.0, 10.0, 41)
    grid, known = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2), fields()

    @jax.jit
    def mapped(x, y, count):
        return GaussianProcess.fit(kernel, NOISE_VARIANCE, x, y, count=count).predict(jnp.asarray(grid))

    def errors(route: np.ndarray, budget: int, seed: int) -> list[float]:
        """Mean standard deviation of the map, and its RMSE on each field."""
        points, exists = samples_along(jnp.asarray(route), SPACING, round(budget / SPACING))
        noise = NOISE * np.random.default_rng(seed).standard_normal(len(points))
        found, variance = [], np.zeros(len(grid))
        for field in known.values():
            mean, variance = mapped(points, field(np.asarray(points)) + noise, jnp.sum(exists))
            found.append(math.sqrt(np.mean((field(grid) - np.asarray(mean)) ** 2)))
        return [float(np.sqrt(np.asarray(variance)).mean()), *found]

    table = Table(title=f"Means over {args.starts} starts (standard errors)")
    for heading in (
        "length",
        "route",
        "mean deviation",
        *(f"RMSE, {name}" for name in known),
        "CPU s a route",
    ):
        table.add_column(heading, justify="left" if heading == "route" else "right")
    area = Area.rectangle(0.0, 0.0, 10.0, 10.0)
    for budget in args.budgets:
        planned, seconds = [], []
        for index in range(args.starts):
            begin = time.process_time()
            first = {"lawnmower": np.asarray(peers[f"lawnmower-{budget}"][index])}
            start, key = np.asarray(peers["starts"][index][:2]), jax.random.key(args.seed + index)
            route = plan_route(prior, area, float(budget), start, None, first, key, spacing=SPACING)
            planned.append(route.waypoints)
            seconds.append(time.process_time() - begin)
        routes = {
            "lawnmower": peers[f"lawnmower-{budget}"],
            "SGP-Tools": peers[f"sgptools-{budget}"],
            "bojax": planned,
        }
        for name, each in routes.items():
            scores = np.asarray(
                [errors(np.asarray(each[index]), budget, index) for index in range(args.starts)]
            )
            spread = scores.std(axis=0, ddof=1) / math.sqrt(args.starts) if args.starts > 1 else 0 * scores[0]
            cells = [f"{a:.3f} ({b:.3f})" for a, b in zip(scores.mean(axis=0), spread, strict=True)]
            taken = f"{np.median(seconds[1:] or seconds):.1f}" if name == "bojax" else ""
            table.add_row(str(budget), name, *cells, taken)
    Console().print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
