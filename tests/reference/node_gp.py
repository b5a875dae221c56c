"""The Gaussian process of a tree node, from action parameters to rewards (2.28-2.29)."""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial.distance import cdist


class Kernel:
    """A stationary kernel: a profile of the distance in lengthscales."""

    def __init__(self, profile, lengthscale):
        self.profile = profile
        self.lengthscale = lengthscale

    def __call__(self, xs, ys):
        return self.profile(cdist(xs / self.lengthscale, ys / self.lengthscale))


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


class NodeGP:
    """Zero mean, k(x, x) = 1; the Cholesky factor of K + noise I grows by a row per observation."""

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
