"""A Gaussian process of many observations, summarised at inducing points (Titsias 2009).

Titsias, Variational Learning of Inducing Variables in Sparse Gaussian Processes (AISTATS 2009), equation 6.
With inducing points U, L L' = k(U, U), A = L^-1 k(U, X) / s and B = I + A A', the posterior at x has the mean
w' B^-1 A y / s and the variance k(x, x) - w' (I - B^-1) w, where w = L^-1 k(U, x) and s^2 is the noise.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel
from bojax.numerics.linalg import inverse_cholesky, matmul

JITTER = 1e-8  # share of the prior variance that is added to k(U, U)
LEAST = 1e-12  # of the eigenvalues of A A'

FINEST, GROWTH = 0.1, 1.15
"""Side of the first cells of `spread_inducing` in lengthscales, and the factor by which it grows."""


@eqx.filter_jit
def sparse_posterior(
    kernel: Kernel,
    noise_variance: Float[Array, ""],
    x: Float[Array, "N D"],
    y: Float[Array, "N"],
    inducing: Float[Array, "M D"],
    count: Int[Array, ""] | None = None,
) -> GaussianProcess:
    """The posterior given all observations, in the form of one of M pseudo-observations at inducing points.

    Predictions, `whiten` and what is computed from them are those of equation 6. The pseudo-observations have
    correlated noise: the posterior can be neither refitted nor updated. With a `count`, only the first rows
    are observations.
    """
    gram = kernel.gram(inducing, inducing)
    gram = gram + JITTER * jnp.mean(jnp.diagonal(gram)) * jnp.eye(len(inducing), dtype=y.dtype)
    inverse = inverse_cholesky(gram)  # L^-1
    across = kernel.gram(inducing, x)
    if count is not None:
        across = jnp.where(jnp.arange(len(y), dtype=count.dtype)[None, :] < count, across, 0.0)
    scaled = matmul(inverse, across) / jnp.sqrt(noise_variance)
    # I - B^-1 = Q diag(v / (1 + v)) Q' with the eigenvalues v of A A': the square root of it replaces the
    # inverse Cholesky factor of the pseudo-observations, and y is such that the means agree.
    values, vectors = jnp.linalg.eigh(matmul(scaled, scaled.T))
    values = jnp.maximum(values, LEAST)
    root = jnp.sqrt(values / (1.0 + values))
    factor = root[:, None] * matmul(vectors.T, inverse)
    residuals = matmul(vectors.T, matmul(scaled, y)) / (jnp.sqrt(noise_variance) * (1.0 + values) * root)
    pseudo = matmul(jnp.linalg.inv(inverse), matmul(vectors, residuals / root))
    empty = GaussianProcess.prior(kernel, noise_variance, len(inducing), x.shape[1])
    leaves = inducing, pseudo, factor, jnp.asarray(len(inducing), jnp.int32)
    return eqx.tree_at(lambda gp: (gp.x, gp.y, gp.inverse_cholesky, gp.count), empty, leaves)


def spread_inducing(points: Any, lengthscale: float, number: int) -> np.ndarray:
    """Inducing points `[number, 2]` spread over points `[N, 2]`, with N at least `number`.

    They are the means of the points in the cells of a grid, which is as fine as the number allows; further
    points fill up the number.
    """
    points, side = np.asarray(points, float), FINEST * lengthscale
    while True:
        _, cell = np.unique(np.floor(points / side).astype(np.int64), axis=0, return_inverse=True)
        cell = cell.reshape(-1)
        if cell.max() < number:
            break
        side *= GROWTH
    counts = np.bincount(cell)
    means = np.stack([np.bincount(cell, column) / counts for column in points.T], axis=1)
    further = np.random.default_rng(0).permutation(len(points))[: number - len(means)]
    return np.concatenate([means, points[further]])
