"""Linear regression by least squares (2.8), and its maximum a posteriori estimate (2.14)."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from bojax.numerics.linalg import matmul


class LinearRegression(eqx.Module):
    """A linear function of the features, y = w' phi(x) (2.4); columns of `targets` are fitted side by side.

    Attributes:
        weights: One weight for each feature, and each target where there are several.
    """

    weights: Float[Array, "M *K"]

    @classmethod
    def fit(cls, features: Float[Array, "N M"], targets: Float[Array, "N *K"]) -> "LinearRegression":
        """The weights of least squared error (2.8), the shortest of them where several are equally good.

        Solved by the singular values of the features, not by the normal equations, which square their
        condition number; singular values below max(N, M) rounding errors of the largest count as zero.
        Without observations the weights are zero.
        """
        return cls(jnp.linalg.lstsq(features, targets)[0])

    @classmethod
    def fit_map(
        cls,
        features: Float[Array, "N M"],
        targets: Float[Array, "N *K"],
        prior_precision: Float[Array, ""],
        noise_precision: Float[Array, ""],
    ) -> "LinearRegression":
        """The most probable weights under the prior N(0, I / prior_precision) (2.14): ridge regression.

        The same least squares with sqrt(prior_precision / noise_precision) I below the features and zeros
        below the targets.
        """
        num_features = features.shape[1]
        ridge = jnp.sqrt(prior_precision / noise_precision) * jnp.eye(num_features, dtype=features.dtype)
        nothing = jnp.zeros((num_features, *targets.shape[1:]), targets.dtype)
        return cls.fit(jnp.concatenate([features, ridge]), jnp.concatenate([targets, nothing]))

    def predict(self, features: Float[Array, "N M"]) -> Float[Array, "N *K"]:
        """Values at the points with these features."""
        return matmul(features, self.weights)
