"""A Gaussian process over the plane, from all of its data at once (2.28-2.29, with a prior mean)."""

import numpy as np
from scipy.linalg import solve_triangular

from tests.reference.node_gp import Kernel


class Stationary(Kernel):
    """k(x, y) = profile(r) with r the distance in lengthscales.

    Its gradient in x is slope(r) (x - y) / lengthscale^2, with slope(r) = profile'(r) / r.
    """

    def __init__(self, profile, slope, lengthscale):
        super().__init__(profile, lengthscale)
        self.slope = slope

    def gradient(self, xs, ys):
        """[len(xs), len(ys), 2]."""
        step = (xs[:, None] - ys[None]) / self.lengthscale
        return self.slope(np.linalg.norm(step, axis=-1))[..., None] * step / self.lengthscale


def rbf_slope(r):
    return -np.exp(-0.5 * r**2)


def matern12_slope(r):
    """Where the points coincide the kernel has a kink, and no slope."""
    return np.where(r > 0.0, -np.exp(-r) / np.where(r > 0.0, r, 1.0), 0.0)


def matern32_slope(r):
    return -3.0 * np.exp(-np.sqrt(3.0) * r)


def matern52_slope(r):
    s = np.sqrt(5.0) * r
    return -5.0 / 3.0 * (1.0 + s) * np.exp(-s)


class Scaled:
    def __init__(self, kernel, variance):
        self.kernel = kernel
        self.variance = variance

    def __call__(self, xs, ys):
        return self.variance * self.kernel(xs, ys)

    def gradient(self, xs, ys):
        return self.variance * self.kernel.gradient(xs, ys)


class Sum:
    def __init__(self, first, second):
        self.first = first
        self.second = second

    def __call__(self, xs, ys):
        return self.first(xs, ys) + self.second(xs, ys)

    def gradient(self, xs, ys):
        return self.first.gradient(xs, ys) + self.second.gradient(xs, ys)


class Product:
    def __init__(self, first, second):
        self.first = first
        self.second = second

    def __call__(self, xs, ys):
        return self.first(xs, ys) * self.second(xs, ys)

    def gradient(self, xs, ys):
        first, second = self.first(xs, ys)[..., None], self.second(xs, ys)[..., None]
        return self.first.gradient(xs, ys) * second + first * self.second.gradient(xs, ys)


class LinearMean:
    """m(x) = slope' x + bias; a constant one has no slope."""

    def __init__(self, slope, bias):
        self.slope = np.asarray(slope)
        self.bias = bias

    def __call__(self, xs):
        return xs @ self.slope + self.bias


class GP:
    """The posterior given values `y` observed at `x` with noise."""

    def __init__(self, kernel, mean, noise_variance, x, y):
        self.kernel = kernel
        self.mean = mean
        self.noise_variance = noise_variance
        self.x = x
        # K + noise I = L L'
        self.cholesky = np.linalg.cholesky(kernel(x, x) + noise_variance * np.eye(len(x)))
        whitened = self._solve(y - mean(x))
        self.weights = self._solve(whitened, transposed=True)

    def predict(self, xs):
        """Mean and covariance of the noise-free function at `xs`."""
        covariances = self.kernel(self.x, xs)
        whitened = self._solve(covariances)
        mean = self.mean(xs) + self.weights @ covariances
        return mean, self.kernel(xs, xs) - whitened.T @ whitened

    def gradient(self, xs):
        """Gradient of the mean at `xs`."""
        return self.mean.slope + np.einsum("mnd,n->md", self.kernel.gradient(xs, self.x), self.weights)

    def _solve(self, b, transposed=False):
        return solve_triangular(self.cholesky, b, lower=True, trans=int(transposed), check_finite=False)
