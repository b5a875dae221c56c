"""Beliefs for long missions: inducing points and nearest neighbours beside the exact Gaussian process.

    python benchmarks/long_beliefs.py

Measurements along a lawnmower in the square of the league of surveys, of a field that its process has drawn.
Neighbours: each point is predicted from its nearest measurements, as in Vecchia's approximation. Inducing
points are those of a mission.
"""

import time

import jax
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from bojax.surveys.lawnmower import lawnmower
from bojax.surveys.league.fields import LENGTHSCALE, NOISE_VARIANCE, SQUARE, VARIANCE
from bojax.surveys.measurements import belief_from
from bojax.surveys.polylines import length_of, points_along

SPACING, NUMBERS, NEIGHBOURS, INDUCING = 0.2, (1000, 4000), (16, 64, 128), (256, 1024)


def main() -> None:
    """Print a table: errors of means and deviations against the exact ones, and seconds of a prediction."""
    table = Table(title="prediction at 1,600 points, with the process's hyper-parameters")
    for heading in ("measurements", "belief", "error of the mean", "error of the deviation", "CPU s"):
        table.add_column(heading, justify="right")
    for number in NUMBERS:
        route = lawnmower(SQUARE, 100.0 / (SPACING * number)).route
        x = points_along(route, SPACING * np.arange(1, int(length_of(route) / SPACING)))
        grid, random = SQUARE.grid(0.25), np.random.default_rng(0)
        both = np.concatenate([x, grid])
        draw = np.linalg.cholesky(covariance(both, both) + 1e-9 * np.eye(len(both)))
        y = (draw @ random.standard_normal(len(both)))[: len(x)]
        y = y + NOISE_VARIANCE**0.5 * random.standard_normal(len(x))
        mean, deviation = near(x, y, grid)
        for name, predict in methods(x, y, grid).items():
            predict()  # compiles
            begin = time.process_time()
            found = predict()
            seconds = time.process_time() - begin
            errors = [
                f"{np.sqrt(np.mean((mine - exact) ** 2)) / deviation.mean():.3f}"
                for mine, exact in zip(found, (mean, deviation), strict=True)
            ]
            table.add_row(f"{len(x):,}", name, *errors, f"{seconds:.2f}")
    Console().print(table)


def methods(x, y, grid):
    """Predictions of means and deviations, by name."""

    def sparse(most):
        with jax.enable_x64(True):
            mean, variance = belief_from((LENGTHSCALE, VARIANCE, NOISE_VARIANCE), x, y, most).predict(grid)
            return np.asarray(mean), np.sqrt(np.asarray(variance))

    def neighbours(number):
        chosen = np.asarray(KDTree(x).query(grid, number)[1])
        parts = [near(x[each], y[each], point[None]) for each, point in zip(chosen, grid, strict=True)]
        return tuple(np.concatenate(column) for column in zip(*parts, strict=True))

    found = {f"{most} inducing points": lambda most=most: sparse(most) for most in INDUCING}
    found |= {f"{each} neighbours": lambda each=each: neighbours(each) for each in NEIGHBOURS}
    return found


def near(x, y, points):
    """Mean and deviation at points, given all measurements."""
    factor = cho_factor(covariance(x, x) + NOISE_VARIANCE * np.eye(len(x)))
    cross = covariance(points, x)
    variance = VARIANCE - np.sum(cross * cho_solve(factor, cross.T).T, axis=1)
    return cross @ cho_solve(factor, y), np.sqrt(variance)


def covariance(first, second):
    """Matern 5/2 covariance of the league's process."""
    scaled = np.sqrt(5.0) * cdist(first, second) / LENGTHSCALE
    return VARIANCE * (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)


if __name__ == "__main__":
    main()
