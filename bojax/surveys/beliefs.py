"""The belief of a mission: exact from a few measurements, sparse from many; predictions from the nearest."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import KDTree

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.models.sparse import sparse_posterior, spread_inducing

LEAST_CAPACITY = 64
"""Measurements that every belief has room for; a larger one, compiled anew, has twice as many."""


BATCH = 128
"""Queries that are predicted at once from their own measurements."""


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
    size = _power_of_two(max(number, expected))
    with jax.enable_x64(True):
        x, y = np.zeros((size, 2)), np.zeros(size)
        x[:number], y[:number] = points, values
        count = jnp.asarray(number, jnp.int32)
        kernel, noise = model_of(hyperparameters)
        if number <= most:
            return GaussianProcess.fit(kernel, noise, x, y, count=count)
        inducing = jnp.asarray(spread_inducing(points, hyperparameters[0], most))
        return sparse_posterior(kernel, noise, jnp.asarray(x), jnp.asarray(y), inducing, count)


def predict_near(
    hyperparameters: tuple[float, float, float],
    points: np.ndarray,
    values: np.ndarray,
    queries: np.ndarray,
    number: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance `[M]` at queries `[M, 2]`, each from its nearest measurements alone.

    Vecchia (1988), of each query given no other one. The time grows linearly with both numbers.

    Args:
        hyperparameters: Lengthscale, variance and noise variance.
        points: Positions `[N, 2]`, m.
        values: Standardised values `[N]`.
        queries: Where to predict, m.
        number: Number of measurements for each query, at most `N`.
    """
    nearest = np.asarray(KDTree(points).query(queries, number)[1])
    with jax.enable_x64(True):
        mean, variance = _predict_each(*model_of(hyperparameters), points[nearest], values[nearest], queries)
    return np.asarray(mean), np.asarray(variance)


@jax.jit
def _predict_each(
    kernel: Scaled,
    noise: Float[Array, ""],
    points: Float[Array, "M K 2"],
    values: Float[Array, "M K"],
    queries: Float[Array, "M 2"],
) -> tuple[Float[Array, "M"], Float[Array, "M"]]:
    def one(data: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        x, y, query = data
        mean, variance = GaussianProcess.fit(kernel, noise, x, y).predict(query[None])
        return mean[0], variance[0]

    return jax.lax.map(one, (points, values, queries), batch_size=BATCH)


def model_of(hyperparameters: tuple[float, float, float]) -> tuple[Scaled, jax.Array]:
    """Kernel and noise variance."""
    lengthscale, variance, noise = (jnp.asarray(value, jnp.float64) for value in hyperparameters)
    return Scaled(Matern52(lengthscale), variance), noise


def _power_of_two(number: int) -> int:
    """The least power of two that is not below a number and `LEAST_CAPACITY`."""
    return max(LEAST_CAPACITY, 1 << (number - 1).bit_length())
