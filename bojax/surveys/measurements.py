"""What a mission has measured, and the belief about the field that it learns from this."""

from collections import Counter
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bojax.fields.raster import LARGEST, NO_DATA
from bojax.models.evidence import LogPrior, log_normal_prior, relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.models.sparse import sparse_posterior, spread_inducing
from bojax.surveys.polylines import Waypoints

LEAST_DATA = 10  # measurements before hyper-parameters are learned
SPREAD = 1.0  # of the log-normal prior of the hyper-parameters
MOST_EXACT = 256
"""Measurements up to which the belief is exact in a plan; of more, it is summarised at as many points.

Hyper-parameters are learned from as many of them at most."""

RELEARNING = 2**31  # first of the numbers that are folded into the keys of relearning; plans have small ones

LEAST_CAPACITY = 64
"""Measurements that every belief has room for; a larger one, compiled anew, has twice as many."""

predict = eqx.filter_jit(GaussianProcess.predict)
"""Posterior mean and variance at points, as one program in place of one for each operation."""


def belief_from(
    hyperparameters: tuple[float, float, float],
    points: np.ndarray,
    values: np.ndarray,
    most: int,
    expected: int = 0,
) -> GaussianProcess:
    """The belief from measurements at points `[N, 2]`.

    Arrays are padded to a power of two, so that few programs are compiled.

    Args:
        hyperparameters: Lengthscale, variance and noise variance.
        points: Positions, m.
        values: Standardised values `[N]`.
        most: Measurements up to which the belief is exact; of more, it is summarised at as many points.
        expected: Measurements for which it has room from the first on.
    """
    number = len(values)
    size = max(LEAST_CAPACITY, 1 << (max(number, expected) - 1).bit_length())
    with jax.enable_x64(True):
        x, y = np.zeros((size, 2)), np.zeros(size)
        x[:number], y[:number] = points, values
        count = jnp.asarray(number, jnp.int32)
        kernel, noise = model_of(hyperparameters)
        if number <= most:
            return GaussianProcess.fit(kernel, noise, x, y, count=count)
        inducing = jnp.asarray(spread_inducing(points, hyperparameters[0], most))
        return sparse_posterior(kernel, noise, jnp.asarray(x), jnp.asarray(y), inducing, count)


def model_of(hyperparameters: tuple[float, float, float]) -> tuple[Scaled, jax.Array]:
    """Kernel and noise variance."""
    lengthscale, variance, noise = (jnp.asarray(value, jnp.float64) for value in hyperparameters)
    return Scaled(Matern52(lengthscale), variance), noise


class Measurements:
    """Measurements, and a Gaussian process of the standardised values with a Matern 5/2 kernel.

    Attributes:
        x: Positions `[N, 2]`, m.
        y: Values `[N]`.
        hyperparameters: Lengthscale (m), variance and noise variance, both of standardised values.
        medians: Their first values, about which they are learned.
        shift: Mean by which values are standardised.
        scale: Standard deviation by which they are.
        learned_at: Number of measurements when the hyper-parameters were learned last.
        expected: Number of measurements for which the belief has room from the first on.
    """

    def __init__(self, hyperparameters: tuple[float, float, float], expected: int = 0):
        self.x, self.y = np.zeros((0, 2)), np.zeros(0)
        self.hyperparameters = self.medians = hyperparameters
        self.shift, self.scale = 0.0, 1.0
        self.learned_at, self.expected = 0, expected
        self._held: set[tuple[float, ...]] = set()  # rows of x and y together, to find duplicates

    def __len__(self) -> int:
        return len(self.y)

    def take(self, points: Waypoints, values: np.ndarray, is_far: np.ndarray, counts: Counter[str]) -> int:
        """Add values `[S]` at points `[S, 2]`, and return how many were added.

        What cannot be used is left out, and counted by its reason; `is_far` marks points that are too far
        away.
        """
        is_finite = np.isfinite(values) & np.isfinite(points).all(axis=1)
        rows = np.column_stack([points, values])
        is_taken = np.zeros(len(rows), bool)
        for index, row in enumerate(map(tuple, rows.tolist())):
            reason = (
                "not_finite" if not is_finite[index]
                else "too_large" if abs(values[index]) > LARGEST
                else "no_data" if values[index] in NO_DATA
                else "far_off" if is_far[index]
                else "duplicate" if row in self._held
                else ""
            )  # fmt: skip
            if reason:
                counts[reason] += 1
                continue
            self._held.add(row)
            is_taken[index] = True
        self.x = np.concatenate([self.x, points[is_taken]])
        self.y = np.concatenate([self.y, values[is_taken]])
        return int(np.sum(is_taken))

    def restore(self, x: Waypoints, y: np.ndarray) -> None:
        """Set all measurements at once, as they were taken before."""
        self.x, self.y = x, y
        self._held = set(map(tuple, np.column_stack([x, y]).tolist()))

    def relearn(self, seed: int, shortest: float, longest: float) -> None:
        """See `Mission.relearn`; the lengthscale stays between the shortest and the longest, m."""
        if len(self) < LEAST_DATA:
            return
        self.learned_at = len(self)
        self.shift, scale = float(np.mean(self.y)), float(np.std(self.y))
        self.scale = scale if scale > 0.0 else 1.0
        with jax.enable_x64(True):
            key = jax.random.fold_in(jax.random.key(seed), RELEARNING + len(self))
            prior = _prior_about(self.medians)
            gp, _ = relearn(self.some(seed), key, log_prior=prior, num_starts=2)
            kernel: Any = gp.kernel
            found = kernel.kernel.lengthscale, kernel.variance, gp.noise_variance
        lengthscale, variance, noise = map(float, found)
        self.hyperparameters = (float(np.clip(lengthscale, shortest, longest)), variance, noise)

    def standardised(self, values: Any) -> Any:
        """Values in the units of the belief."""
        return (values - self.shift) / self.scale

    def belief(self, most: int) -> GaussianProcess:
        """The belief about the standardised values, see `belief_from`."""
        return belief_from(self.hyperparameters, self.x, self.standardised(self.y), most, self.expected)

    def some(self, seed: int) -> GaussianProcess:
        """The exact belief from at most `MOST_EXACT` of the measurements, drawn at random."""
        chosen = np.arange(len(self))
        if len(self) > MOST_EXACT:
            random = np.random.default_rng([seed, len(self)])
            chosen = np.sort(random.choice(chosen, MOST_EXACT, replace=False))
        return belief_from(
            self.hyperparameters, self.x[chosen], self.standardised(self.y[chosen]), MOST_EXACT
        )

    def predict(self, points: Waypoints, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the field at points `[M, 2]` in its units, see `belief`."""
        with jax.enable_x64(True):
            mean, variance = predict(self.belief(most), points)
            deviation = np.sqrt(np.asarray(variance))
        return self.shift + self.scale * np.asarray(mean), self.scale * deviation


@lru_cache(maxsize=8)
def _prior_about(medians: tuple[float, float, float]) -> LogPrior:
    """The prior of all missions with these medians: each function compiles `relearn` anew."""
    return log_normal_prior(*model_of(medians), SPREAD)
