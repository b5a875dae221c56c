"""Linear regression by least squares (2.8), and its maximum a posteriori estimate (2.14)."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bojax.models.checks import (
    Numbers,
    check_number,
    check_readings,
    is_known,
    to_data,
    to_numbers,
    to_points,
)
from bojax.numerics.linalg import matmul


class LinearRegression(eqx.Module):
    """A linear function of the features, y = w' phi(x) (2.4); each column of `targets` is fitted separately.

    Features and targets may be lists, or arrays of NumPy or JAX.

    Attributes:
        weights: Weight of each feature, with a column for each target if there are several.
    """

    weights: Float[Array, "M *K"]

    @classmethod
    def fit(
        cls, features: Float[Array, "N M"] | Numbers, targets: Float[Array, "N *K"] | Numbers
    ) -> "LinearRegression":
        """The weights of least squared error (2.8); of several solutions, the one of minimum norm.

        Solved by a singular value decomposition, since the normal equations would square the condition number
        of the features. Singular values below max(N, M) machine epsilons of the largest one count as zero.
        Without observations the weights are zero.

        Raises:
            ValueError: An observation is not finite (unless compiled), or a shape is wrong.
        """
        features, targets = _finite_data(features, targets)
        return cls(jnp.linalg.lstsq(features, targets)[0])

    @classmethod
    def fit_map(
        cls,
        features: Float[Array, "N M"] | Numbers,
        targets: Float[Array, "N *K"] | Numbers,
        prior_precision: Float[Array, ""] | Numbers,
        noise_precision: Float[Array, ""] | Numbers,
    ) -> "LinearRegression":
        """The most probable weights under the prior N(0, I / prior_precision) (2.14): ridge regression.

        Solved by least squares, with sqrt(prior_precision / noise_precision) I appended to the features and
        zeros appended to the targets.

        Raises:
            ValueError: A precision is not positive, or an observation is not finite (unless compiled), or a
                shape is wrong.
        """
        features, targets = _finite_data(features, targets)
        num_features, dtype = features.shape[1], features.dtype
        prior_precision = to_numbers("prior_precision", prior_precision, dtype)
        noise_precision = to_numbers("noise_precision", noise_precision, dtype)
        for name, value in (("prior_precision", prior_precision), ("noise_precision", noise_precision)):
            if is_known(value):
                check_number(name, value, str(dtype), is_above=True)
        ridge = jnp.sqrt(prior_precision / noise_precision) * jnp.eye(num_features, dtype=dtype)
        nothing = jnp.zeros((num_features, *targets.shape[1:]), targets.dtype)
        return cls.fit(jnp.concatenate([features, ridge]), jnp.concatenate([targets, nothing]))

    def predict(self, features: Float[Array, "N M"] | Numbers) -> Float[Array, "N *K"]:
        """Values at the points with these features."""
        return matmul(to_points("features", features, self.weights.dtype, len(self.weights)), self.weights)


def _finite_data(features: Any, targets: Any) -> tuple[Float[Array, "N M"], Float[Array, "N *K"]]:
    features, targets = to_data(features, targets)
    if is_known((features, targets)):
        check_readings(("features", features), ("targets", targets), np.ones(len(targets), bool))
    return features, targets
