"""Returns, a linear baseline for them, and generalised advantage estimation (Schulman et al., ICLR 2016)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.numerics.linalg import inverse_cholesky, matmul

_RIDGE = 1e-5  # ridge of the baseline's fit, relative to the mean square of each feature


def discounted_sums(
    terms: Float[Array, "N"], is_last: Bool[Array, "N"], factor: Float[Array, ""]
) -> Float[Array, "N"]:
    """Sum of each term and the later ones of its episode, each step discounted by `factor`."""
    # x_t = term_t + factor_t x_(t+1), with a factor of 0 at the end of an episode: compositions of affine
    # maps, which are associative, so that a scan from the end takes log N steps instead of N.
    factors = jnp.where(is_last, jnp.zeros_like(factor), factor)

    def join(later, earlier):
        return later[0] * earlier[0], earlier[1] + earlier[0] * later[1]

    return jax.lax.associative_scan(join, (factors, terms), reverse=True)[1]


def td_errors(
    rewards: Float[Array, "N"],
    values: Float[Array, "N"],
    is_last: Bool[Array, "N"],
    discount: Float[Array, ""],
) -> Float[Array, "N"]:
    """The errors r + gamma V(s') - V(s), whose sums discounted by gamma lambda are generalised advantages.

    `values` are V of the states before the steps. The value after the last step of an episode is 0, even
    after a time limit, as in the published code of VIME.
    """
    after = jnp.where(is_last, jnp.zeros_like(values), jnp.append(values[1:], values[:1]))
    return rewards + discount * after - values


class LinearBaseline(eqx.Module):
    """Returns as a linear function of the observation, its square, and the first three powers of time.

    The baseline of rllab (Duan et al., ICML 2016), with the features o, o^2, t/100, (t/100)^2, (t/100)^3 and
    1; observations are clipped to [-10, 10]. That code adds 1e-5 to the diagonal of the normal equations and
    solves them by a singular value decomposition. Here the features are scaled to a mean square of 1 first,
    so that a Cholesky factor exists even in single precision.
    """

    weights: Float[Array, "F"]  # weight of each feature

    @classmethod
    def zero(cls, num_dims: int, dtype: jnp.dtype) -> "LinearBaseline":
        """The baseline that is 0 for observations of this size."""
        return cls(jnp.zeros((2 * num_dims + 4,), dtype))

    @classmethod
    def fit(
        cls,
        observations: Float[Array, "N D"],
        steps: Int[Array, "N"],
        returns: Float[Array, "N"],
        is_valid: Bool[Array, "N"],
    ) -> "LinearBaseline":
        """The baseline of least squared error on the valid rows."""
        features = jnp.where(is_valid[:, None], _features(observations, steps), 0.0)
        number = jnp.maximum(jnp.sum(is_valid), 1).astype(features.dtype)
        scale = jnp.sqrt(jnp.sum(features**2, axis=0) / number)
        scale = jnp.where(scale > 0.0, scale, 1.0)
        features = features / scale[None]
        gram = matmul(features.T, features) / number + _RIDGE * jnp.eye(len(scale), dtype=features.dtype)
        inverse = inverse_cholesky(gram)
        products = matmul(features.T, jnp.where(is_valid, returns, 0.0)) / number
        return cls(matmul(inverse.T, matmul(inverse, products)) / scale)

    def predict(self, observations: Float[Array, "N D"], steps: Int[Array, "N"]) -> Float[Array, "N"]:
        """Expected return from each observation, given the number of steps before it in its episode."""
        return matmul(_features(observations, steps), self.weights)


def _features(observations: Float[Array, "N D"], steps: Int[Array, "N"]) -> Float[Array, "N F"]:
    clipped = jnp.clip(observations, -10.0, 10.0)
    time = steps.astype(clipped.dtype)[:, None] / 100.0
    return jnp.concatenate([clipped, clipped**2, time, time**2, time**3, jnp.ones_like(time)], axis=1)
