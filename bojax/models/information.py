"""What observations say about a Gaussian process: the variance that they explain elsewhere, their entropy.

It does not depend on the observed values. With data X, an observation set Z and a place g, the variance at g
falls by |B^-1 c(Z, g)|^2, where c is the posterior covariance given X and B B' = c(Z, Z) + noise: row i of
B^-1 c(Z, g) is what observation i explains, given those before it.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bojax.models.gaussian_process import GaussianProcess
from bojax.numerics.linalg import inverse_cholesky, matmul


class Places(eqx.Module):
    """Places whose variance counts, prepared for many sets of observations."""

    points: Float[Array, "M D"]  # their positions
    weights: Float[Array, "M"]  # their weights, which sum to 1
    whitened: Float[Array, "N M"]  # L^-1 k(X, points)

    @classmethod
    def of(
        cls, posterior: GaussianProcess, points: Float[Array, "M D"], weights: Float[Array, "M"]
    ) -> "Places":
        """These places under a belief; the weights need not sum to 1."""
        return cls(points, weights / jnp.sum(weights), posterior.whiten(points))


def explained_variance(
    posterior: GaussianProcess,
    places: Places,
    samples: Float[Array, "S D"],
    is_taken: Bool[Array, "S"],
    samples_per_point: Float[Array, ""] | float = 1.0,
) -> Float[Array, "S M"]:
    """Reduction of the variance at each place by each sample, given those before it.

    Samples are in the order of sampling; one that is not taken explains nothing. Each stands for
    `samples_per_point` measurements: its noise variance is divided by this number.
    """
    whitened = posterior.whiten(samples)
    noise = jnp.where(is_taken, posterior.noise(samples) / samples_per_point, 1.0)
    across = posterior.kernel.gram(samples, places.points) - matmul(whitened.T, places.whitened)
    across = jnp.where(is_taken[:, None], across, 0.0)
    return matmul(inverse_cholesky(_joint(posterior, samples, whitened, is_taken, noise)), across) ** 2


def entropy_taken(
    posterior: GaussianProcess, samples: Float[Array, "S D"], is_taken: Bool[Array, "S"]
) -> Float[Array, "S"]:
    """Entropy in nats that each sample takes from the belief about the field, given those before it.

    It is half the logarithm of 1 + v / noise, with the variance v of the field at the sample; the sum is the
    mutual information of field and samples. A sample that is not taken takes nothing.
    """
    noise = jnp.where(is_taken, posterior.noise(samples), 1.0)
    joint = _joint(posterior, samples, posterior.whiten(samples), is_taken, noise)
    # The variance of a sample given those before it is the square on the diagonal of the Cholesky factor.
    return -jnp.log(jnp.diagonal(inverse_cholesky(joint))) - 0.5 * jnp.log(noise)


def _joint(
    posterior: GaussianProcess,
    samples: Float[Array, "S D"],
    whitened: Float[Array, "N S"],
    is_taken: Bool[Array, "S"],
    noise: Float[Array, "S"],
) -> Float[Array, "S S"]:
    """Covariance of the samples; one that is not taken is independent of the others, with its noise alone."""
    both = is_taken[:, None] & is_taken[None, :]
    covariance = posterior.kernel.gram(samples, samples) - matmul(whitened.T, whitened)
    return jnp.where(both, covariance, 0.0) + jnp.diag(noise)
