"""Gaussian process regression of fixed capacity, updated by an incremental inverse Cholesky factor."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.models.kernels import Kernel
from bojax.numerics.linalg import matmul, noise_floor


class GaussianProcess(eqx.Module):
    """The posterior of a zero-mean Gaussian process given `count` noisy observations (2.28-2.29).

    Rows past `count` are zero, in the data and in the factor, so that they drop out of every product.
    An update appends one row to the inverse Cholesky factor: no triangular solve, no refit.

    Attributes:
        kernel: Prior covariance.
        noise_variance: Variance of the observation noise; below `noise_floor` it counts as that.
        x: Inputs.
        y: Observed values.
        inverse_cholesky: `L^-1`, with `L L' = K + noise_variance I`.
        count: Number of observations held.
    """

    kernel: Kernel
    noise_variance: Float[Array, ""]
    x: Float[Array, "N D"]
    y: Float[Array, "N"]
    inverse_cholesky: Float[Array, "N N"]
    count: Int[Array, ""]

    @classmethod
    def prior(
        cls, kernel: Kernel, noise_variance: Float[Array, ""], capacity: int, num_dims: int
    ) -> "GaussianProcess":
        """No observation yet, room for `capacity` of them."""
        dtype = noise_variance.dtype
        return cls(
            kernel=kernel,
            noise_variance=noise_variance,
            x=jnp.zeros((capacity, num_dims), dtype),
            y=jnp.zeros((capacity,), dtype),
            inverse_cholesky=jnp.zeros((capacity, capacity), dtype),
            count=jnp.zeros((), jnp.int32),
        )

    def update(self, x: Float[Array, "D"], y: Float[Array, ""]) -> "GaussianProcess":
        """The posterior after one more observation; dropped without a trace once the capacity is reached."""
        at = self.count
        row = self.next_row(x, self.whiten(x[None, :])[:, 0])
        return GaussianProcess(
            kernel=self.kernel,
            noise_variance=self.noise_variance,
            x=self.x.at[at].set(x, mode="drop"),
            y=self.y.at[at].set(y, mode="drop"),
            inverse_cholesky=self.inverse_cholesky.at[at].set(row, mode="drop"),
            count=jnp.minimum(at + 1, self.y.shape[0]).astype(at.dtype),
        )

    def whiten(self, xs: Float[Array, "M D"]) -> Float[Array, "N M"]:
        """L^-1 k(X, xs), from which everything about `xs` follows."""
        return matmul(self.inverse_cholesky, self.kernel.gram(self.x, xs))

    def next_row(self, x: Float[Array, "D"], whitened: Float[Array, "N"]) -> Float[Array, "N"]:
        """The row that an observation at `x` appends to the inverse Cholesky factor; `whitened` is its own.

        With l = L^-1 k(X, x) and d^2 = k(x, x) + noise - l'l, the row is [-l' L^-1, 1] / d. In exact
        arithmetic d^2 is at least the noise variance; it is kept there against rounding.
        """
        variance = self.kernel(x, x)
        # The floor is part of the noise of every row: if d^2 alone were kept above it, L would belong to no
        # matrix, and a third observation of one point without noise would make it explode.
        noise = jnp.maximum(self.noise_variance, noise_floor(x.dtype) * variance)
        pivot = jnp.sqrt(jnp.maximum(variance + noise - jnp.sum(whitened * whitened), noise))
        row = -matmul(whitened, self.inverse_cholesky)
        return jnp.where(self._is_next(), 1.0, row) / pivot

    def next_whitened(
        self,
        x: Float[Array, "D"],
        whitened: Float[Array, "N"],
        row: Float[Array, "N"],
        xs: Float[Array, "M D"],
        whitened_xs: Float[Array, "N M"],
    ) -> Float[Array, "M"]:
        """The row that an observation at `x` appends to `whiten(xs)`, given what it appends to the factor.

        Rows never change once they are there: who asks about the same `xs` after every observation keeps
        them, and pays for N M products where whitening anew takes N^2 M and N M covariances.
        """
        inverse_pivot = jnp.sum(jnp.where(self._is_next(), row, 0.0))
        return (self.kernel.gram(x[None, :], xs)[0] - matmul(whitened, whitened_xs)) * inverse_pivot

    def _is_next(self) -> Bool[Array, "N"]:
        return jnp.arange(self.y.shape[0], dtype=self.count.dtype) == self.count

    def moments(
        self, xs: Float[Array, "M D"], whitened: Float[Array, "N M"]
    ) -> tuple[Float[Array, "M"], Float[Array, "M"]]:
        """What `predict` returns, from the `whitened` covariances of `xs`."""
        mean = matmul(matmul(self.inverse_cholesky, self.y), whitened)
        prior = jax.vmap(lambda x: self.kernel(x, x))(xs)
        return mean, jnp.maximum(prior - jnp.sum(whitened * whitened, axis=0), 0.0)

    def predict(self, xs: Float[Array, "M D"]) -> tuple[Float[Array, "M"], Float[Array, "M"]]:
        """Posterior mean and variance of the noise-free function at `xs` (2.28, 2.29)."""
        return self.moments(xs, self.whiten(xs))
