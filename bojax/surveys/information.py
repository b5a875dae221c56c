"""What a route teaches about a field: the posterior deviation over an area after the samples of a polyline.

The posterior variance of a Gaussian process does not depend on the measured values, so the error that a
route leaves is known before it is driven (`bojax.models.information`).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Scalar

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.information import Places, explained_variance
from bojax.numerics.linalg import matmul

Number = Float[Array, ""] | float

LEAST_VARIANCE = 1e-12
"""Share of the variance below which a posterior variance has no gradient, as its root has an infinite one."""


def path_length(waypoints: Float[Array, "W 2"]) -> Scalar:
    """Length of a polyline, m; its gradient is 0 at pieces without length."""
    return jnp.sum(_piece_lengths(waypoints))


def points_at(waypoints: Float[Array, "W 2"], distances: Float[Array, "S"]) -> Float[Array, "S 2"]:
    """Points of a polyline at these distances from its first waypoint, m; its last one beyond its end.

    Differentiable in the waypoints: a sample stays at its distance while the pieces before it change.
    """
    lengths = _piece_lengths(waypoints)
    ends = jnp.cumsum(lengths)
    last = lengths.shape[0] - 1
    piece = jnp.minimum(jnp.searchsorted(ends, distances), last)
    behind = jnp.where(piece > 0, ends[piece - 1], 0.0)
    length = lengths[piece]
    share = (distances - behind) / jnp.where(length > 0.0, length, 1.0)
    share = jnp.clip(share, 0.0, 1.0)[:, None]
    return (1.0 - share) * waypoints[piece] + share * waypoints[piece + 1]


def samples_along(
    waypoints: Float[Array, "W 2"], spacing: Number, number: int
) -> tuple[Float[Array, "S 2"], Bool[Array, "S"]]:
    """Samples at every `spacing` metres of a polyline, and whether each lies on it.

    The first is `spacing` behind the start. With `number` = budget / spacing, rounded down, no sample lies
    beyond the budget, whatever the length of the polyline.
    """
    distances = spacing * jnp.arange(1, number + 1, dtype=waypoints.dtype)
    # A polyline that uses its budget ends at its last sample but for rounding.
    is_taken = distances <= path_length(waypoints) + 1e-9 * distances[-1]
    return points_at(waypoints, distances), is_taken


def samples_of_all(
    routes: Float[Array, "K W 2"], spacing: Number, number: int
) -> tuple[Float[Array, "S 2"], Bool[Array, "S"]]:
    """Samples at every `spacing` metres of all routes; those at equal distances are neighbours."""
    samples, is_taken = jax.vmap(lambda route: samples_along(route, spacing, number))(routes)
    return jnp.swapaxes(samples, 0, 1).reshape(-1, 2), is_taken.T.reshape(-1)


class PointErrors(eqx.Module):
    """The belief about a set of points, prepared for many routes."""

    posterior: GaussianProcess  # the belief given the data
    grid: Float[Array, "M 2"]  # points at which the error counts, m
    weights: Float[Array, "M"]  # their weights, which sum to 1
    whitened: Float[Array, "N M"]  # L^-1 k(X, grid)
    variance: Float[Array, "M"]  # posterior variances at the grid

    @classmethod
    def of(
        cls, posterior: GaussianProcess, grid: Float[Array, "M 2"], weights: Float[Array, "M"] | None = None
    ) -> "PointErrors":
        """The belief at `grid`, where all points count alike unless weights are given."""
        weights = jnp.ones(grid.shape[0], grid.dtype) if weights is None else weights
        whitened = posterior.whiten(grid)
        variance = posterior.moments(grid, whitened)[1]
        return cls(posterior, grid, weights / jnp.sum(weights), whitened, variance)

    def explained(
        self, samples: Float[Array, "S 2"], is_taken: Bool[Array, "S"], samples_per_point: Number = 1.0
    ) -> Float[Array, "S M"]:
        """Reduction of the variance at each grid point by each sample, see `explained_variance`."""
        places = Places(self.grid, self.weights, self.whitened)
        return explained_variance(self.posterior, places, samples, is_taken, samples_per_point)

    def mean_deviation(self, variance: Float[Array, "*T M"]) -> Float[Array, "*T"]:
        """Weighted mean of the standard deviations."""
        least = LEAST_VARIANCE * jnp.max(self.variance)
        return matmul(jnp.sqrt(jnp.maximum(variance, least)), self.weights)

    def after(
        self, samples: Float[Array, "S 2"], is_taken: Bool[Array, "S"], samples_per_point: Number = 1.0
    ) -> Scalar:
        """Root of the mean posterior variance after all samples; differentiable in their positions.

        It is the root mean squared error that the belief expects. The mean deviation would weigh the points
        that no route comes near too little: it is concave in the variance.
        """
        explained = self.explained(samples, is_taken, samples_per_point)
        return jnp.sqrt(matmul(self.variance - jnp.sum(explained, axis=0), self.weights))


@eqx.filter_jit
def left_by(
    errors: PointErrors,
    samples: Float[Array, "S 2"],
    is_taken: Bool[Array, "S"],
    samples_per_point: Number = 1.0,
) -> tuple[Float[Array, "T"], Float[Array, "M"]]:
    """Mean deviation that each number of samples leaves, 0 first, and the variances that all leave."""
    explained = jnp.cumsum(errors.explained(samples, is_taken, samples_per_point), axis=0)
    before = jnp.zeros((1, explained.shape[1]), explained.dtype)
    variance = errors.variance[None] - jnp.concatenate([before, explained])
    return errors.mean_deviation(variance), variance[-1]


def _piece_lengths(waypoints: Float[Array, "W 2"]) -> Float[Array, "V"]:
    squared = jnp.sum(jnp.diff(waypoints, axis=0) ** 2, axis=-1)
    # The gradient of the root at 0 is infinite: pieces without length have none.
    return jnp.where(squared > 0.0, jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0)), 0.0)
