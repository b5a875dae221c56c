"""The belief of a mission: exact from a few measurements, sparse from many."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.models.sparse import sparse_posterior, spread_inducing

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
