"""Thompson sampling: the next point maximises a draw of the posterior. Not in the thesis."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key, Scalar
from typing_extensions import override

from bojax.models.checks import check_count
from bojax.models.features import RandomFourier
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.means import Mean
from bojax.numerics.linalg import matmul


class ThompsonSampling(eqx.Module):
    """Draws of the posterior by Matheron's rule.

    Wilson et al., "Efficiently sampling functions from Gaussian process posteriors" (ICML 2020).

    A draw of the prior, on random Fourier features, is conditioned on the observations minus a draw of their
    noise: f(x) + k(x, X) (K + noise)^-1 (y - f(X) - e). The features approximate the prior alone, so that the
    draw follows the observations however many there are.

    Unlike an acquisition function, a draw is not a function of the posterior mean and standard deviation of a
    point. `BayesianOptimisation` takes it in the place of one; planners do not.

    Attributes:
        num_features: Number of features, even.
    """

    num_features: int = eqx.field(static=True, default=1024)

    def __check_init__(self):
        check_count("num_features", self.num_features, 2)
        if self.num_features % 2:
            raise ValueError(f"num_features: got {self.num_features}; allowed: even, >= 2")

    def draw(self, key: Key[Array, ""], posterior: GaussianProcess) -> GaussianProcess:
        """A process whose posterior mean is a draw of the noise-free function; its variance is as before.

        All observations have the noise variance of the process.

        Raises:
            TypeError: The spectral density of a part of the kernel is not known.
        """
        key_features, key_weights, key_noise = jax.random.split(key, 3)
        features = RandomFourier.draw(key_features, posterior.kernel, self.num_features, posterior.x.shape[1])
        weights = jax.random.normal(key_weights, (self.num_features,), posterior.y.dtype)
        noise = jax.random.normal(key_noise, posterior.y.shape, posterior.y.dtype)
        noise = noise * jnp.sqrt(posterior.noise(posterior.x))
        told = posterior.y - jnp.where(posterior.is_held(), noise, 0.0)
        return replace(posterior, y=told, mean=_Drawn(posterior.mean, features, weights))


class _Drawn(Mean):
    """A prior mean plus a draw of the prior around it, f(x) = m(x) + phi(x)' w with w ~ N(0, I)."""

    mean: Mean
    features: RandomFourier
    weights: Float[Array, "M"]

    @override
    def __call__(self, x: Float[Array, "D"]) -> Scalar:
        return self.mean(x) + matmul(self.weights, self.features(x))
