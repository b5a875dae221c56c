"""Gaussian process regression with a fixed capacity and an incremental inverse Cholesky factor."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.models.checks import (
    Numbers,
    check_count,
    check_key,
    check_readings,
    compiled_if_known,
    is_known,
    precision,
    to_numbers,
    to_point,
    to_points,
)
from bojax.models.kernels import Kernel, KernelName, as_kernel
from bojax.models.means import ConstantMean, Mean, ZeroMean
from bojax.numerics.linalg import eigh, guarded_cholesky, inverse_cholesky, matmul, noise_floor

NO_MEAN = ZeroMean()


class GaussianProcess(eqx.Module):
    """The posterior of a Gaussian process given `count` noisy observations (2.28-2.29, with a prior mean).

    Rows past `count` are zero, in the data and in the factor. An update appends one row to the inverse
    Cholesky factor and needs neither a triangular solve nor a refit.

    An observation that is not finite, or beyond the capacity, is refused with an error. In a compiled
    function, whose numbers are not known, it is left out and counted.

    Inputs, values and noise variances may be Python numbers, lists, or arrays of NumPy or JAX. They are
    converted to the precision of the kernel. Inputs of one dimension may be given without their last axis.

    Attributes:
        kernel: Prior covariance.
        noise_variance: Default variance of the observation noise. It is raised to a floor, `noise_floor`
            times the prior variance at the observed point, with a warning outside of compiled functions; 0
            means the floor.
        x: Inputs.
        y: Observed values.
        inverse_cholesky: `L^-1`, with `L L' = K + diag(noise variances)`.
        count: Number of observations.
        num_ignored: Number of observations left out: not finite, or beyond the capacity.
        mean: Prior mean.
    """

    kernel: Kernel
    noise_variance: Float[Array, ""]
    x: Float[Array, "N D"]
    y: Float[Array, "N"]
    inverse_cholesky: Float[Array, "N N"]
    count: Int[Array, ""]
    num_ignored: Int[Array, ""]
    mean: Mean = NO_MEAN

    @classmethod
    def prior(
        cls,
        kernel: Kernel | KernelName,
        noise_variance: Float[Array, ""] | Numbers,
        capacity: int,
        num_dims: int,
        mean: Mean = NO_MEAN,
    ) -> "GaussianProcess":
        """The prior, without observations and with room for `capacity` of them."""
        kernel = as_kernel(kernel)
        capacity = check_count("capacity", capacity, 0)
        dtype = precision(kernel, noise_variance)
        noise_variance = to_numbers("noise_variance", noise_variance, dtype)
        if noise_variance.shape:
            raise ValueError(f"noise_variance: got shape {noise_variance.shape}; allowed: one number")
        return cls(
            kernel=kernel,
            noise_variance=noise_variance,
            x=jnp.zeros((capacity, num_dims), dtype),
            y=jnp.zeros((capacity,), dtype),
            inverse_cholesky=jnp.zeros((capacity, capacity), dtype),
            count=jnp.zeros((), jnp.int32),
            num_ignored=jnp.zeros((), jnp.int32),
            mean=mean,
        )

    @classmethod
    def fit(
        cls,
        kernel: Kernel | KernelName,
        noise_variance: Float[Array, ""] | Numbers,
        x: Float[Array, "n D"] | Numbers,
        y: Float[Array, "n"] | Numbers,
        *,
        mean: Mean = NO_MEAN,
        count: Int[Array, ""] | None = None,
        capacity: int | None = None,
        noise_variances: Float[Array, "n"] | Numbers | None = None,
    ) -> "GaussianProcess":
        """The posterior given all observations at once, by a Cholesky factor; differentiable.

        Args:
            kernel: Prior covariance, an object or a name, such as `"rbf"`.
            noise_variance: Variance of the observation noise.
            x: Inputs.
            y: Observed values.
            mean: Prior mean.
            count: Number of observations, in the first rows; by default every row is an observation.
            capacity: Maximum number of observations; by default the number of rows.
            noise_variances: Noise variance of each observation, instead of `noise_variance`.

        Raises:
            ValueError: There are more rows than the capacity, not as many values as inputs, or (unless
                compiled) a variance is negative or not finite, or an observation is not finite (in a compiled
                function, it is left out and counted).
        """
        kernel = as_kernel(kernel)
        dtype = precision(kernel, noise_variance)
        x = to_points("x", x, dtype)
        y = to_numbers("y", y, dtype)
        number, num_dims = x.shape
        if y.shape != (number,):
            raise ValueError(f"y: got shape {y.shape}; allowed: {number} numbers, one for each row of x")
        capacity = number if capacity is None else check_count("capacity", capacity, 0)
        if capacity < number:
            raise ValueError(f"capacity: got {capacity}; allowed: >= {number}, the number of observations")
        empty = cls.prior(kernel, noise_variance, capacity, num_dims, mean)
        count = jnp.asarray(number, jnp.int32) if count is None else jnp.clip(count, 0, number)
        if noise_variances is not None:
            noise_variances = to_numbers("noise_variances", noise_variances, dtype)
        is_given = jnp.arange(number, dtype=count.dtype) < count
        args = empty, x, y, is_given, noise_variances
        if is_known(args):
            check_readings(("x", x), ("y", y), is_given)
            empty._check_noise(x, is_given, noise_variances)
        return _all_at_once(*args)

    def refitted(
        self,
        kernel: Kernel,
        noise_variance: Float[Array, ""],
        noise_variances: Float[Array, "N"] | None = None,
    ) -> "GaussianProcess":
        """The posterior given the same observations under another kernel and other noise; differentiable."""
        # Rows past `count` get a noise of 1 and no covariances: an identity block, which the factor leaves
        # apart from the others, and which is then cleared. The capacity is fixed, so that the program is as
        # well.
        is_held = self.is_held()
        both = is_held[:, None] & is_held[None, :]
        changed = eqx.tree_at(lambda gp: (gp.kernel, gp.noise_variance), self, (kernel, noise_variance))
        noise = jnp.where(is_held, changed.noise(self.x, noise_variances), 1.0)
        covariance = jnp.where(both, kernel.gram(self.x, self.x), 0.0) + jnp.diag(noise)
        inverse = jnp.where(both, inverse_cholesky(covariance), 0.0)
        return eqx.tree_at(lambda gp: gp.inverse_cholesky, changed, inverse)

    def with_constant_mean(self) -> "GaussianProcess":
        """The posterior with the constant prior mean of highest evidence; 0 without observations.

        With C = K + noise, it is 1' C^-1 y / 1' C^-1 1.
        """
        # Both forms by whitened vectors, (L^-1 1)'(L^-1 y) over |L^-1 1|^2: no product with C^-1 itself.
        ones = matmul(self.inverse_cholesky, self.is_held().astype(self.y.dtype))
        size = jnp.sum(ones * ones)
        value = jnp.sum(ones * matmul(self.inverse_cholesky, self.y)) / jnp.where(size > 0.0, size, 1.0)
        return eqx.tree_at(lambda gp: gp.mean, self, ConstantMean(value))

    def update(
        self,
        x: Float[Array, "D"] | Numbers,
        y: Float[Array, ""] | Numbers,
        noise_variance: Float[Array, ""] | Numbers | None = None,
    ) -> "GaussianProcess":
        """The posterior after one more observation.

        Raises:
            ValueError: The observation is not finite, or the capacity is reached (in a compiled function, the
                observation is then left out and counted).
        """
        x = to_point("x", x, self.y.dtype, self.x.shape[1])
        y = to_numbers("y", y, self.y.dtype)
        if noise_variance is not None:
            noise_variance = to_numbers("noise_variance", noise_variance, self.y.dtype)
        if is_known((self, x, y, noise_variance)):
            is_valid = jnp.ones(1, bool)
            self._check_room(("x", x[None, :]), ("y", y[None]), is_valid)
            self._check_noise(x[None, :], is_valid, noise_variance)
        return self._updated(x, y, noise_variance)

    @compiled_if_known
    def _updated(
        self, x: Float[Array, "D"], y: Float[Array, ""], noise_variance: Float[Array, ""] | None
    ) -> "GaussianProcess":
        # An observation that is not finite is written past the end, which drops it. Its x is cleared first:
        # NaN would pass through the products below, even if their result is not stored.
        is_finite = jnp.isfinite(y) & jnp.all(jnp.isfinite(x))
        x = jnp.where(is_finite, x, 0.0)
        row = self.next_row(x, self.whiten(x[None, :])[:, 0], noise_variance)
        at = jnp.where(is_finite, self.count, self.y.shape[0])
        return self._appended(at, x, y, row, is_finite.astype(self.count.dtype), jnp.ones_like(self.count))

    def extend(
        self,
        xs: Float[Array, "S D"] | Numbers,
        ys: Float[Array, "S"] | Numbers,
        is_valid: Bool[Array, "S"] | Bool[np.ndarray, "S"] | Sequence[bool] | None = None,
        noise_variances: Float[Array, "S"] | Numbers | None = None,
    ) -> "GaussianProcess":
        """The posterior after several more observations, as by an `update` with each of the valid ones.

        With V = L^-1 k(X, xs) and B B' = k(xs, xs) + noise - V'V, the rows [-B^-1 V' L^-1, B^-1] are
        appended. Invalid observations are not stored; by default all are valid.

        Raises:
            ValueError: A valid observation is not finite, or the valid ones exceed the capacity (in a
                compiled function, such observations are left out and counted).
        """
        xs, ys = self._points(xs), to_numbers("ys", ys, self.y.dtype)
        if noise_variances is not None:
            noise_variances = to_numbers("noise_variances", noise_variances, self.y.dtype)
        is_valid = jnp.ones(ys.shape, bool) if is_valid is None else jnp.asarray(is_valid, bool)
        if is_known((self, xs, ys, is_valid, noise_variances)):
            self._check_room(("xs", xs), ("ys", ys), is_valid)
            self._check_noise(xs, is_valid, noise_variances)
        return self._extended(xs, ys, is_valid, noise_variances)

    @compiled_if_known
    def _extended(
        self,
        xs: Float[Array, "S D"],
        ys: Float[Array, "S"],
        is_valid: Bool[Array, "S"],
        noise_variances: Float[Array, "S"] | None,
    ) -> "GaussianProcess":
        # The Schur complement of the old observations in the covariance of all: its Cholesky factor B
        # continues L. An invalid observation has a unit row in it and a place past the end, so that the
        # others do not see it.
        capacity = self.y.shape[0]
        given = jnp.sum(is_valid, dtype=self.count.dtype)
        is_valid = is_valid & jnp.isfinite(ys) & jnp.all(jnp.isfinite(xs), axis=1)
        xs = jnp.where(is_valid[:, None], xs, 0.0)
        noise = self.noise(xs, noise_variances)
        whitened = jnp.where(is_valid[None, :], self.whiten(xs), 0.0)
        both = is_valid[:, None] & is_valid[None, :]
        complement = jnp.where(both, self.kernel.gram(xs, xs) - matmul(whitened.T, whitened), 0.0)
        complement = complement + jnp.diag(jnp.where(is_valid, noise, 1.0))
        _, inverse = guarded_cholesky(complement, jnp.where(is_valid, noise, 0.0))
        # The valid observations take successive places, whichever they are among the given ones.
        place = self.count + jnp.cumsum(is_valid, dtype=self.count.dtype) - 1
        at = jnp.where(is_valid, place, capacity)
        own = jnp.zeros((xs.shape[0], capacity), xs.dtype).at[:, at].set(inverse, mode="drop")
        rows = own - matmul(inverse, matmul(whitened.T, self.inverse_cholesky))
        return self._appended(at, xs, ys, rows, jnp.sum(is_valid, dtype=self.count.dtype), given)

    def noise(
        self, xs: Float[Array, "M D"], noise_variances: Float[Array, "M"] | None = None
    ) -> Float[Array, "M"]:
        """Noise variances of observations at `xs`, raised to the floor.

        The floor is `noise_floor` times the prior variance at each point.
        """
        # On the diagonal of the covariance: a floor of the pivots alone would give an L that factorises no
        # matrix, and a third noise-free observation of the same point would make it diverge.
        noise_variances = self.noise_variance if noise_variances is None else noise_variances
        return jnp.maximum(noise_variances, noise_floor(xs.dtype) * self._prior_variance(xs))

    def whiten(self, xs: Float[Array, "M D"]) -> Float[Array, "N M"]:
        """L^-1 k(X, xs), from which all predictions at `xs` are computed."""
        return matmul(self.inverse_cholesky, self.kernel.gram(self.x, xs))

    def next_row(
        self,
        x: Float[Array, "D"],
        whitened: Float[Array, "N"],
        noise_variance: Float[Array, ""] | None = None,
    ) -> Float[Array, "N"]:
        """The row that an observation at `x` appends to the inverse Cholesky factor.

        With l = L^-1 k(X, x), given as `whitened`, and d^2 = k(x, x) + noise - l'l, the row is
        [-l' L^-1, 1] / d. In exact arithmetic d^2 is at least the noise variance; a d^2 that rounding takes
        below it is raised to it.
        """
        # Place `count` of the product is 0, as rows and columns past `count` are: the mask puts 1 there.
        row = -matmul(whitened, self.inverse_cholesky)
        is_next = jnp.arange(self.y.shape[0], dtype=self.count.dtype) == self.count
        return jnp.where(is_next, 1.0, row) / self._next_pivot(x, whitened, noise_variance)

    def next_whitened(
        self,
        x: Float[Array, "D"],
        whitened: Float[Array, "N"],
        xs: Float[Array, "M D"],
        whitened_xs: Float[Array, "N M"],
    ) -> Float[Array, "M"]:
        """The row that an observation at `x` appends to `whiten(xs)`.

        Existing rows never change. A caller that predicts at the same `xs` after every observation can keep
        `whitened_xs` and append this row: N M products instead of N^2 M.

        Args:
            x: Input of the observation.
            whitened: `whiten` of `x`.
            xs: Points of the predictions.
            whitened_xs: `whiten` of `xs`, before the observation.
        """
        inverse_pivot = 1.0 / self._next_pivot(x, whitened, None)
        return (self.kernel.gram(x[None, :], xs)[0] - matmul(whitened, whitened_xs)) * inverse_pivot

    def _next_pivot(
        self, x: Float[Array, "D"], whitened: Float[Array, "N"], noise_variance: Float[Array, ""] | None
    ) -> Float[Array, ""]:
        """The pivot d of an observation at `x`, see `next_row`."""
        variance = self.kernel(x, x)
        noise_variance = self.noise_variance if noise_variance is None else noise_variance
        noise = self.noise(x[None, :], noise_variance[None])[0]
        return jnp.sqrt(jnp.maximum(variance + noise - jnp.sum(whitened * whitened), noise))

    def residuals(self) -> Float[Array, "N"]:
        """Observed values minus the prior mean, y - m(X); 0 past `count`."""
        return self.y - jnp.where(self.is_held(), jax.vmap(self.mean)(self.x), 0.0)

    def whitened_residuals(self) -> Float[Array, "N"]:
        """L^-1 (y - m(X)), independent with variance 1 if the model is correct; 0 past `count`."""
        # Columns of the factor past `count` are zero, so the mean needs no mask there.
        return matmul(self.inverse_cholesky, self.y - jax.vmap(self.mean)(self.x))

    def weights(self) -> Float[Array, "N"]:
        """(K + noise)^-1 (y - m(X)), so that the predictive mean is m(x) + k(x, X) weights."""
        return matmul(self.whitened_residuals(), self.inverse_cholesky)

    def moments(
        self, xs: Float[Array, "M D"], whitened: Float[Array, "N M"]
    ) -> tuple[Float[Array, "M"], Float[Array, "M"]]:
        """The result of `predict(xs)`, given `whitened`, which is `whiten(xs)`."""
        mean = matmul(self.whitened_residuals(), whitened)
        variance = self._prior_variance(xs) - jnp.sum(whitened * whitened, axis=0)
        return jax.vmap(self.mean)(xs) + mean, jnp.maximum(variance, 0.0)

    def predict(self, xs: Float[Array, "M D"] | Numbers) -> tuple[Float[Array, "M"], Float[Array, "M"]]:
        """Posterior mean and variance of the noise-free function at `xs` (2.28, 2.29)."""
        xs = self._points(xs)
        return self.moments(xs, self.whiten(xs))

    def predict_first(
        self, xs: Float[Array, "M D"], counts: Int[Array, "T"]
    ) -> tuple[Float[Array, "T M"], Float[Array, "T M"]]:
        """The result of `predict` given only the first n observations, for each n in `counts`."""
        # L^-1 is lower triangular: its leading block is the factor of the first n observations. (2.28) and
        # (2.29) are sums over its rows, so that a cumulative sum holds the answers for every n.
        whitened = self.whiten(xs)
        parts = self.whitened_residuals()[:, None] * whitened, whitened * whitened
        nothing = jnp.zeros_like(whitened[:1])
        mean, explained = (jnp.concatenate([nothing, jnp.cumsum(part, axis=0)])[counts] for part in parts)
        variance = self._prior_variance(xs)[None] - explained
        return jax.vmap(self.mean)(xs)[None] + mean, jnp.maximum(variance, 0.0)

    def predict_gradient(self, xs: Float[Array, "M D"] | Numbers) -> Float[Array, "M D"]:
        """Gradient of the posterior mean at `xs`; a kernel contributes 0 where it is not differentiable."""
        xs, weights = self._points(xs), self.weights()

        def mean(x: Float[Array, "D"]) -> Float[Array, ""]:
            return self.mean(x) + matmul(self.kernel.gram(x[None, :], self.x)[0], weights)

        return jax.vmap(jax.grad(mean))(xs)

    def predict_covariance(
        self, xs: Float[Array, "M D"] | Numbers
    ) -> tuple[Float[Array, "M"], Float[Array, "M M"]]:
        """Posterior mean and covariance matrix of the noise-free function at `xs` (2.28, 2.29)."""
        xs = self._points(xs)
        whitened = self.whiten(xs)
        mean, variance = self.moments(xs, whitened)
        covariance = self.kernel.gram(xs, xs) - matmul(whitened.T, whitened)
        # The diagonal equals the variances of `predict`, which are never negative.
        is_diagonal = jnp.eye(xs.shape[0], dtype=bool)
        return mean, jnp.where(is_diagonal, variance[None, :], covariance)

    def sample(
        self, key: Key[Array, ""], xs: Float[Array, "M D"] | Numbers, num: int
    ) -> Float[Array, "num M"]:
        """Joint draws of the noise-free function at `xs`."""
        check_key(key)
        check_count("num", num, 0)
        # By eigenvalues: for points near each other, rounding makes some of them slightly negative, and they
        # count as 0. A Cholesky factor would need jitter instead.
        mean, covariance = self.predict_covariance(xs)
        values, vectors = eigh(covariance)
        normal = jax.random.normal(key, (num, mean.shape[0]), mean.dtype)
        return mean[None, :] + matmul(normal * jnp.sqrt(jnp.maximum(values, 0.0))[None, :], vectors.T)

    def log_marginal_likelihood(self) -> Float[Array, ""]:
        """Log marginal likelihood of the observed values (2.30)."""
        # log det C = -2 sum log diag(L^-1); places past `count` contribute log 1 and 0.
        whitened = self.whitened_residuals()
        pivots = jnp.where(self.is_held(), jnp.diagonal(self.inverse_cholesky), 1.0)
        constant = 0.5 * math.log(2.0 * math.pi) * self.count.astype(whitened.dtype)
        return jnp.sum(jnp.log(pivots)) - 0.5 * jnp.sum(whitened * whitened) - constant

    def _points(self, xs: Float[Array, "M D"] | Numbers) -> Float[Array, "M D"]:
        return to_points("xs", xs, self.x.dtype, self.x.shape[1])

    def _prior_variance(self, xs: Float[Array, "M D"]) -> Float[Array, "M"]:
        return jax.vmap(lambda x: self.kernel(x, x))(xs)

    def _appended(self, at, x, y, row, number: Int[Array, ""], given: Int[Array, ""]) -> "GaussianProcess":
        """The posterior with `number` more observations, of `given`, in the rows `at`, up to the capacity."""
        count = jnp.minimum(self.count + number, self.y.shape[0]).astype(self.count.dtype)
        return replace(
            self,
            x=self.x.at[at].set(x, mode="drop"),
            y=self.y.at[at].set(y, mode="drop"),
            inverse_cholesky=self.inverse_cholesky.at[at].set(row, mode="drop"),
            count=count,
            num_ignored=self.num_ignored + given - (count - self.count),
        )

    def _check_room(self, xs: tuple[str, Array], ys: tuple[str, Array], is_valid: Bool[Array, "S"]) -> None:
        check_readings(xs, ys, is_valid)
        number, held, capacity = int(jnp.sum(is_valid)), int(self.count), self.y.shape[0]
        if held + number > capacity:
            raise ValueError(
                f"{ys[0]}: got {number} more beside {held}; allowed: {capacity} observations, the capacity"
            )

    def _check_noise(
        self,
        xs: Float[Array, "S D"],
        is_valid: Bool[Array, "S"],
        noise_variances: Array | None,
    ) -> None:
        """Refuse a variance that is negative or not finite, and warn of noise that is raised to the floor."""
        own = np.asarray(self.noise_variance if noise_variances is None else noise_variances)
        if own.shape not in ((), is_valid.shape):
            raise ValueError(f"noise_variances: got shape {own.shape}; allowed: {is_valid.shape}")
        is_given, given = np.asarray(is_valid), np.broadcast_to(own, is_valid.shape)
        prior = np.asarray(_variances(self, xs))
        for name, variances in (("noise_variance", given), ("kernel: prior variance", prior)):
            wrong = variances[is_given & ~((variances >= 0.0) & np.isfinite(variances))]
            if wrong.size:
                raise ValueError(f"{name}: got {wrong[0]:g}; allowed: finite numbers >= 0")
        used = np.maximum(given, noise_floor(xs.dtype) * prior)
        # More than by rounding; without noise, the floor is what is asked for.
        is_raised = is_given & (given > 0.0) & (used > 1.001 * given)
        if np.any(is_raised):
            least = given[is_raised].min()
            warnings.warn(
                f"noise_variance: got {least:g}; raised to {used[is_raised].max():g}, the least that "
                f"{used.dtype} resolves (see GaussianProcess.noise)",
                stacklevel=3,
            )

    def is_held(self) -> Bool[Array, "N"]:
        """Whether each row holds an observation."""
        return jnp.arange(self.y.shape[0], dtype=self.count.dtype) < self.count


@compiled_if_known
def _all_at_once(
    empty: GaussianProcess,
    x: Float[Array, "n D"],
    y: Float[Array, "n"],
    is_given: Bool[Array, "n"],
    noise_variances: Float[Array, "n"] | None,
) -> GaussianProcess:
    """The posterior given the finite observations among the given ones, which come first."""
    # The finite observations move to the front in their order, so that `count` alone tells which rows are
    # held.
    number = y.shape[0]
    is_held = is_given & jnp.isfinite(y) & jnp.all(jnp.isfinite(x), axis=1)
    order = jnp.argsort(~is_held, stable=True)
    x = jnp.where(is_held[:, None], x, 0.0)[order]
    y = jnp.where(is_held, y, 0.0)[order]
    if noise_variances is not None:
        noise_variances = empty.y.at[:number].set(noise_variances[order])
    count = jnp.sum(is_held, dtype=empty.count.dtype)
    data = replace(
        empty,
        x=empty.x.at[:number].set(x),
        y=empty.y.at[:number].set(y),
        count=count,
        num_ignored=jnp.sum(is_given, dtype=count.dtype) - count,
    )
    return data.refitted(empty.kernel, empty.noise_variance, noise_variances)


_variances = eqx.filter_jit(GaussianProcess._prior_variance)
