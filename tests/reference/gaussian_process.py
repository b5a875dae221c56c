"""Stationary kernels and a Gaussian process, from all of its data at once (2.28-2.29, with a prior mean)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial.distance import cdist


@dataclass
class Stationary:
    """k(x, y) = profile(r) with r the distance in lengthscales.

    Its gradient in x is slope(r) (x - y) / lengthscale^2, with slope(r) = profile'(r) / r.
    """

    profile: Any
    slope: Any
    lengthscale: Any

    def __call__(self, xs, ys):
        return self.profile(cdist(xs / self.lengthscale, ys / self.lengthscale))

    def gradient(self, xs, ys):
        """[len(xs), len(ys), D]."""
        step = (xs[:, None] - ys[None]) / self.lengthscale
        return self.slope(np.linalg.norm(step, axis=-1))[..., None] * step / self.lengthscale


def rbf(r):
    return np.exp(-0.5 * r**2)


def matern12(r):
    return np.exp(-r)


def matern32(r):
    s = np.sqrt(3.0) * r
    return (1.0 + s) * np.exp(-s)


def matern52(r):
    s = np.sqrt(5.0) * r
    return (1.0 + s + s**2 / 3.0) * np.exp(-s)


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


@dataclass
class Scaled:
    kernel: Any
    variance: Any

    def __call__(self, xs, ys):
        return self.variance * self.kernel(xs, ys)

    def gradient(self, xs, ys):
        return self.variance * self.kernel.gradient(xs, ys)


@dataclass
class Sum:
    first: Any
    second: Any

    def __call__(self, xs, ys):
        return self.first(xs, ys) + self.second(xs, ys)

    def gradient(self, xs, ys):
        return self.first.gradient(xs, ys) + self.second.gradient(xs, ys)


@dataclass
class Product:
    first: Any
    second: Any

    def __call__(self, xs, ys):
        return self.first(xs, ys) * self.second(xs, ys)

    def gradient(self, xs, ys):
        first, second = self.first(xs, ys)[..., None], self.second(xs, ys)[..., None]
        return self.first.gradient(xs, ys) * second + first * self.second.gradient(xs, ys)


class LinearMean:
    """m(x) = slope' x + bias; a constant one has no slope."""

    def __init__(self, slope=0.0, bias=0.0):
        self.slope = np.asarray(slope)
        self.bias = bias

    def __call__(self, xs):
        return np.sum(xs * self.slope, axis=-1) + self.bias


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


class NodeGP:
    """The process of a tree node, from action parameters to rewards, of mean zero and k(x, x) = 1.

    The Cholesky factor of K + noise I grows by a row per observation: benchmarks time it.
    """

    def __init__(self, kernel, noise_variance, capacity, num_dims):
        self.kernel = kernel
        self.noise_variance = noise_variance
        self.count = 0
        self._x = np.zeros((capacity, num_dims))
        self._cholesky = np.zeros((capacity, capacity))

    @property
    def x(self):
        return self._x[: self.count]

    @property
    def cholesky(self):
        return self._cholesky[: self.count, : self.count]

    def append(self, x):
        """Observe at `x`: the new row of L is [l', d] with L l = k(X, x) and d^2 = k(x, x) + noise - l'l."""
        n = self.count
        pivot_squared = 1.0 + self.noise_variance
        if n > 0:
            row = self._solve(self.kernel(self.x, x[None])[:, 0])
            self._cholesky[n, :n] = row
            pivot_squared -= row @ row
        self._cholesky[n, n] = np.sqrt(pivot_squared)
        self._x[n] = x
        self.count += 1

    def predict(self, y, xs):
        """Mean and variance at `xs` given the values `y` observed."""
        if self.count == 0:
            return np.zeros(len(xs)), np.ones(len(xs))
        # One solve for the covariances and for y: L [V, u] = [k(X, xs), y].
        solved = self._solve(np.column_stack([self.kernel(self.x, xs), y]))
        whitened, weights = solved[:, :-1], solved[:, -1]
        variance = 1.0 - np.sum(whitened**2, axis=0)
        return weights @ whitened, np.maximum(variance, 0.0)

    def _solve(self, b):
        return solve_triangular(self.cholesky, b, lower=True, check_finite=False)
