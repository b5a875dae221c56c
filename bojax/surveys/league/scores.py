"""Errors of the map that one process makes of what a route measures."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bojax.models.evidence import log_normal_prior, relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.surveys.league.fields import MODEL, Field
from bojax.surveys.league.routes import GRID, SPACING, noises, surveyed
from bojax.surveys.polylines import Waypoints, length_of, points_along

SHARE = 0.2
"""Share of the area above the threshold whose set is to be found."""

Scores = dict[str, float]


def threshold_of(field: Field) -> float:
    """The value that a share `SHARE` of the field's area exceeds."""
    return float(np.quantile(field.value(surveyed(field.area).grid(GRID)), 1.0 - SHARE))


def scores_of(field: Field, route: Waypoints, length: float, index: int) -> Scores:
    """Errors of the map of a field after a route.

    - `rmse` and `deviation`: root mean square error, and mean standard deviation, by the league's process.
    - `rmse_learned`: root mean square error if hyper-parameters are learned from the measurements.
    - `regret`: the field's maximum less its value where the map is highest.
    - `missed`: share of the area on the wrong side of `threshold_of`; `f1`: the F1 score of the set above.
    """
    grid = surveyed(field.area).grid(GRID)
    truth = field.value(grid)
    mean, variance, learned = _mapped(field, route, length, index, grid)
    threshold = threshold_of(field)
    is_above, is_found = truth > threshold, mean > threshold
    agreeing = 2.0 * np.sum(is_above & is_found) / max(np.sum(is_above) + np.sum(is_found), 1)
    return {
        "rmse": math.sqrt(np.mean((truth - mean) ** 2)),
        "rmse_learned": math.sqrt(np.mean((truth - learned) ** 2)),
        "deviation": float(np.sqrt(variance).mean()),
        "regret": float(truth.max() - truth[np.argmax(mean)]),
        "missed": float(np.mean(is_above != is_found)),
        "f1": float(agreeing),
    }


def _mapped(
    field: Field, route: Waypoints, length: float, index: int, grid: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and variance of the map at a grid `[M, 2]`, and the mean with learned hyper-parameters."""
    distances = SPACING * np.arange(1, round(length / SPACING) + 1)
    points = points_along(route, distances)
    count = np.sum(distances <= length_of(route) * (1.0 + 1e-9))  # of a shorter route
    values = field.value(points) + noises(length, index)
    found = _predicted(*map(jnp.asarray, (points, values, count.astype(np.int32), grid)))
    mean, variance, learned = map(np.asarray, found)
    return mean, variance, learned


@eqx.filter_jit
def _predicted(
    x: Float[Array, "N 2"], y: Float[Array, "N"], count: Int[Array, ""], grid: Float[Array, "M 2"]
) -> tuple[Float[Array, "M"], Float[Array, "M"], Float[Array, "M"]]:
    belief = MODEL.belief()
    posterior = GaussianProcess.fit(belief.kernel, belief.noise_variance, x, y, count=count)
    # The largest posterior density, from the league's values and from a second start.
    prior = log_normal_prior(belief.kernel, belief.noise_variance, jnp.asarray(1.0))
    learned, _ = relearn(posterior, jax.random.key(0), log_prior=prior, num_starts=2)
    return *posterior.predict(grid), learned.predict(grid)[0]
