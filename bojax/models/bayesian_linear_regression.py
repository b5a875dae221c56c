"""Bayesian linear regression: batch and sequential posteriors, the evidence, and its maximum."""

import warnings
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

from bojax.models.checks import (
    Numbers,
    check_count,
    check_number,
    check_readings,
    is_known,
    precision,
    to_data,
    to_numbers,
    to_point,
    to_points,
)
from bojax.numerics.linalg import covariance_floor, matmul, matmul_on_tensor_cores

NUM_RATIOS = 128
"""Number of ratios of the precisions that `maximise_evidence` evaluates before it refines the best one."""


class BayesianLinearRegression(eqx.Module):
    """The posterior N(mean, covariance) of the weights of a linear model (2.13).

    The covariance is `base - rows' rows`. With a block of 0, `rows` is empty and every update rewrites
    `base`. With a larger block, an update stores a row, and `flush` subtracts all rows at once. The caller
    must call `flush` at least once every `block` updates: otherwise the oldest rows are lost.

    The noise variance has a floor, `covariance_floor` times the prior variance phi'phi / alpha of the
    observed value. `update` and `row` raise the noise variance of their observation to this floor. `fit` and
    `update_batch` scale the noise variances of all observations by one factor, given by the observation
    furthest below its floor. In sequential updates at the floor, longer feature vectors therefore weigh less.
    Outside of compiled functions, a warning names a noise variance that is raised.

    An observation that is not finite is refused with an error. In a compiled function, whose numbers are not
    known, it is left out and counted.

    Features, targets, precisions and weights may be Python numbers, lists, or arrays of NumPy or JAX. They
    are converted to the precision of the features in `fit`, and of the model in updates and predictions.

    Attributes:
        mean: Mean of the weights, with a column for each target if several targets share the features.
        base: Covariance of the weights at the last flush.
        rows: Rows of the updates since the last flush; unused rows are zero.
        prior_precision: Precision of each weight before any observation: alpha (2.11).
        noise_precision: Precision of the observation noise: beta (2.9).
        num_ignored: Number of observations left out because they are not finite.
    """

    mean: Float[Array, "M *K"]
    base: Float[Array, "M M"]
    rows: Float[Array, "B M"]
    prior_precision: Float[Array, ""]
    noise_precision: Float[Array, ""]
    num_ignored: Int[Array, ""]

    @classmethod
    def prior(
        cls,
        num_features: int,
        prior_precision: Float[Array, ""] | Numbers,
        noise_precision: Float[Array, ""] | Numbers,
        *,
        num_targets: int | None = None,
        block: int = 0,
    ) -> "BayesianLinearRegression":
        """The prior, without observations (2.11).

        Args:
            num_features: Number of features, including the bias.
            prior_precision: Precision of each weight.
            noise_precision: Precision of the observation noise.
            num_targets: Number of targets that share the covariance; None for one target without an axis.
            block: Maximum number of updates between two flushes; 0 applies every update at once.

        Raises:
            ValueError: A count is below its minimum, or a precision is not a positive number (unless
                compiled).
        """
        check_count("num_features", num_features, 1)
        check_count("block", block, 0)
        if num_targets is not None:
            check_count("num_targets", num_targets, 1)
        dtype = precision(prior_precision, noise_precision)
        prior_precision = to_numbers("prior_precision", prior_precision, dtype)
        noise_precision = to_numbers("noise_precision", noise_precision, dtype)
        for name, value in (("prior_precision", prior_precision), ("noise_precision", noise_precision)):
            if is_known(value):
                check_number(name, value, str(dtype), is_above=True)
        targets = () if num_targets is None else (num_targets,)
        return cls(
            mean=jnp.zeros((num_features, *targets), dtype),
            base=jnp.eye(num_features, dtype=dtype) / prior_precision,
            rows=jnp.zeros((block, num_features), dtype),
            prior_precision=prior_precision,
            noise_precision=noise_precision,
            num_ignored=jnp.zeros((), jnp.int32),
        )

    @classmethod
    def fit(
        cls,
        features: Float[Array, "N M"] | Numbers,
        targets: Float[Array, "N *K"] | Numbers,
        prior_precision: Float[Array, ""] | Numbers,
        noise_precision: Float[Array, ""] | Numbers,
        *,
        sample_weight: Float[Array, "N"] | Numbers | None = None,
        block: int = 0,
    ) -> "BayesianLinearRegression":
        """The posterior given all observations at once (2.14, 2.15); differentiable.

        The arguments are as in `prior` and `update`.

        Raises:
            ValueError: An observation is not finite (unless compiled), or a shape is wrong.
        """
        features, targets = to_data(features, targets)
        num_features, dtype = features.shape[1], features.dtype
        prior_precision = to_numbers("prior_precision", prior_precision, dtype)
        prior = cls.prior(num_features, prior_precision, noise_precision, block=block)
        features, targets, sample_weight, num_ignored = prior._seen(features, targets, sample_weight)
        # By QR of the features stacked on sqrt(alpha) I, whose condition number is the square root of the
        # precision matrix's (2.15). With R its factor, S = R^-1 R^-T and m = R^-1 Q'[t; 0].
        scale = jnp.sqrt(prior._precisions(features, sample_weight))
        factor, rotated = _triangular(
            _times_rows(scale, features), _times_rows(scale, targets), prior_precision
        )
        inverse = solve_triangular(factor, jnp.eye(num_features, dtype=factor.dtype))
        mean, base = matmul(inverse, rotated), _symmetric(matmul(inverse, inverse.T))
        return replace(prior, mean=mean, base=base, num_ignored=num_ignored)

    @property
    def covariance(self) -> Float[Array, "M M"]:
        """Covariance of the weights (2.15), including the updates since the last flush."""
        # Symmetric up to rounding: averaging it with its transpose would cost a flush half of its time.
        return self.base - matmul(self.rows.T, self.rows) if len(self.rows) else self.base

    def covariance_times(self, features: Float[Array, "*N M"]) -> Float[Array, "*N M"]:
        """The product of the covariance with each feature vector."""
        product = matmul_on_tensor_cores(features, self.base)
        if len(self.rows):
            product = product - matmul_on_tensor_cores(self._shares(features), self.rows)
        return product

    def variances_and_product(
        self, features: Float[Array, "N M"]
    ) -> tuple[Float[Array, "N"], Float[Array, "M"]]:
        """The variances phi'S phi at feature vectors, and the covariance times the first one."""
        # Fewer products than in `covariance_times`: a row r of the block lowers a variance by (phi'r)^2.
        products = matmul_on_tensor_cores(features, self.base)
        variances, product = jnp.sum(features * products, axis=1), products[0]
        if len(self.rows):
            shares = self._shares(features)
            variances = variances - jnp.sum(shares * shares, axis=1)
            product = product - matmul(shares[0], self.rows)
        return variances, product

    def _shares(self, features: Float[Array, "*N M"]) -> Float[Array, "*N B"]:
        """The products of feature vectors with the rows of the block."""
        # Of two products with the same features, XLA would make one on a GPU, with `base` and `rows` copied
        # into one matrix in each step.
        return matmul_on_tensor_cores(jax.lax.optimization_barrier(features), self.rows.T)

    def row(
        self,
        features: Float[Array, "M"],
        *,
        sample_weight: Float[Array, ""] | None = None,
        product: Float[Array, "M"] | None = None,
    ) -> Float[Array, "M"]:
        """The row r that `update` with the same arguments subtracts from the covariance, S - r r' (5.22).

        The update reduces the variance at any features psi by (psi' r)^2.
        """
        return self._gain(features, sample_weight, product)[0]

    def update(
        self,
        features: Float[Array, "M"] | Numbers,
        target: Float[Array, "*K"] | Numbers,
        *,
        sample_weight: Float[Array, ""] | Numbers | None = None,
        product: Float[Array, "M"] | None = None,
        step_in_block: Int[Array, ""] | int | None = None,
    ) -> "BayesianLinearRegression":
        """The posterior after one more observation (2.21, 2.22 as corrected), in gain form (5.22).

        With u = S phi and k = beta u / (1 + beta phi'u), the update is m += k (t - phi'm), S -= k u'. It
        needs neither a branch nor an inverse.

        Args:
            features: Features of the observation.
            target: Observed value of each target.
            sample_weight: Precision of this observation, in units of `noise_precision`; 1 by default. An
                observation of weight 0 changes nothing, even if it is not finite, but occupies a row of the
                block.
            product: `covariance_times(features)`, if the caller has already computed it.
            step_in_block: Number of updates since the last flush, from 0 to `block` - 1, which is the row of
                the block to write; preferably the same in every run of a batch. By default all rows move up.

        Raises:
            ValueError: The observation is not finite (unless compiled), or a shape is wrong.
        """
        dtype = self.mean.dtype
        features = to_point("features", features, dtype, len(self.mean))
        target = to_numbers("target", target, dtype)
        weight = to_numbers("sample_weight", 1.0 if sample_weight is None else sample_weight, dtype)
        *_, (weight,), num_ignored = self._seen(features[None, :], target[None], weight[None])
        row, gain = self._gain(features, weight, product)
        residual = jnp.where(weight > 0.0, target - matmul(features, self.mean), 0.0)
        # A row of the block is written, and S of M x M numbers only read: half the memory traffic, and one
        # rounding of S in a block instead of one an update. The place of the row comes from the caller, since
        # a count in the state would differ between lanes and make the write a scatter. Without it, all rows
        # move up, which costs 3 to 5% of a step with several hundred features on a GPU.
        base, rows = self.base, self.rows
        if not len(rows):
            base = base - row[:, None] * row[None, :]
        elif isinstance(step_in_block, int) and not 0 <= step_in_block < len(rows):
            raise ValueError(f"step_in_block: got {step_in_block}; allowed: from 0 to {len(rows) - 1}")
        elif step_in_block is None:
            rows = jnp.concatenate([rows[1:], row[None, :]])
        else:
            rows = jax.lax.dynamic_update_index_in_dim(rows, row, step_in_block, axis=0)
        mean = self.mean + jax.vmap(lambda k: k * residual)(gain)
        return replace(self, mean=mean, base=base, rows=rows, num_ignored=num_ignored)

    def update_batch(
        self,
        features: Float[Array, "N M"] | Numbers,
        targets: Float[Array, "N *K"] | Numbers,
        *,
        sample_weight: Float[Array, "N"] | Numbers | None = None,
    ) -> "BayesianLinearRegression":
        """The posterior after several more observations, as by an `update` with each of them in any order.

        The update is applied to `base` at once and occupies no row of the block.

        Raises:
            ValueError: An observation is not finite (unless compiled), or a shape is wrong.
        """
        features, targets = to_data(features, targets, self.mean.dtype)
        features, targets, sample_weight, num_ignored = self._seen(features, targets, sample_weight)
        scale = jnp.sqrt(self._precisions(features, sample_weight))
        # Also in gain form: the factorised matrix I + Phi S Phi' (scaled) has the size of the batch, not of
        # the model.
        scaled = _times_rows(scale, features)
        products = self.covariance_times(scaled)
        innovation = matmul(scaled, products.T) + jnp.eye(len(features), dtype=features.dtype)
        factor = jnp.linalg.cholesky(innovation)
        rows = solve_triangular(factor, products, lower=True)
        residuals = _times_rows(scale, targets - matmul(features, self.mean))
        whitened = solve_triangular(factor, residuals, lower=True)
        base = _symmetric(self.base - matmul(rows.T, rows))
        mean = self.mean + matmul(rows.T, whitened)
        return replace(self, mean=mean, base=base, num_ignored=num_ignored)

    def flush(self) -> "BayesianLinearRegression":
        """Apply the rows of the block to `base`: the same posterior with an empty block."""
        return replace(self, base=self.covariance, rows=jnp.zeros_like(self.rows))

    def predict(
        self, features: Float[Array, "N M"] | Numbers, *, with_noise: bool = False
    ) -> tuple[Float[Array, "N *K"], Float[Array, "N"]]:
        """Predictive mean and variance (2.17, 2.18) of the noise-free value, or of a noisy observation.

        The variance is the same for all targets.
        """
        features = to_points("features", features, self.mean.dtype, len(self.mean))
        variance = jnp.maximum(jnp.sum(features * self.covariance_times(features), axis=1), 0.0)
        if with_noise:
            variance = variance + 1.0 / self.noise_precision
        return matmul(features, self.mean), variance

    def _seen(
        self, features: Float[Array, "N M"], targets: Float[Array, "N *K"], sample_weight: Any
    ) -> tuple[Float[Array, "N M"], Float[Array, "N *K"], Float[Array, "N"], Int[Array, ""]]:
        """Observations with zeros in those without weight, the weights, and the new `num_ignored`.

        An observation that is not finite is refused if the numbers are known, and has no weight otherwise.
        """
        weight = _weights(sample_weight, features)
        is_given = weight > 0.0
        if is_known((self, features, targets, weight)):
            check_readings(("features", features), ("targets", targets), is_given)
            self._warn_of_floor(_where_seen(weight, features), weight)
        is_finite = jnp.all(jnp.isfinite(features), axis=1)
        is_finite = is_finite & jnp.all(jnp.isfinite(targets), axis=tuple(range(1, targets.ndim)))
        weight = jnp.where(is_finite, weight, 0.0)
        num_ignored = self.num_ignored + jnp.sum(is_given & ~is_finite, dtype=self.num_ignored.dtype)
        return _where_seen(weight, features), _where_seen(weight, targets), weight, num_ignored

    def _warn_of_floor(self, features: Float[Array, "N M"], weight: Float[Array, "N"]) -> None:
        """Warn of a noise variance that is raised to the floor."""
        precision = weight * self.noise_precision
        excess = float(np.max(np.asarray(jax.vmap(self._excess)(features, precision)), initial=1.0))
        if excess > 1.0:
            given = 1.0 / float(self.noise_precision)
            warnings.warn(
                f"noise_precision: a noise variance of {given:g} is raised {excess:.3g}-fold, to the least "
                f"that {precision.dtype} resolves (see BayesianLinearRegression)",
                stacklevel=4,
            )

    def _gain(self, features, sample_weight, product) -> tuple[Float[Array, "M"], Float[Array, "M"]]:
        """The row that reduces the covariance, and the gain that multiplies the residual."""
        # The row r = S phi sqrt(beta / (1 + beta phi'S phi)): r r' is the term of (5.22), and the gain k of
        # the mean is this vector times the square root once more. A weight of 0 makes both zero; features and
        # product are cleared first, since 0 times NaN is NaN.
        if product is None:
            product = self.covariance_times(features)
        if sample_weight is None:
            sample_weight = jnp.ones((), features.dtype)
        else:
            features = jnp.where(sample_weight > 0.0, features, 0.0)
            product = jnp.where(sample_weight > 0.0, product, 0.0)
        precision = sample_weight * self.noise_precision
        precision = precision / jnp.maximum(1.0, self._excess(features, precision))
        variance = jnp.maximum(jnp.sum(features * product), 0.0)
        scale = jnp.sqrt(precision / (1.0 + precision * variance))
        row = scale * product
        return row, scale * row

    def _precisions(self, features, sample_weight) -> Float[Array, "N"]:
        """Precisions of observations given together, all reduced by one factor to respect the floor."""
        precision = sample_weight * self.noise_precision
        return precision / jnp.max(jax.vmap(self._excess)(features, precision), initial=1.0)

    def _excess(self, features, precision) -> Float[Array, ""]:
        """The floor of an observation's noise variance, divided by the noise variance."""
        # Below the floor, the rounding error of the covariance is as large as the predictive variance, and
        # updates diverge.
        prior_variance = jnp.sum(features * features) / self.prior_precision
        return precision * covariance_floor(features.dtype) * prior_variance


def log_marginal_likelihood(
    features: Float[Array, "N M"] | Numbers,
    targets: Float[Array, "N"] | Numbers,
    prior_precision: Float[Array, ""] | Numbers,
    noise_precision: Float[Array, ""] | Numbers,
) -> Float[Array, ""]:
    """Logarithm of the evidence, ln p(t | alpha, beta): the negative of (2.23); differentiable."""
    features, targets = to_data(features, targets)
    prior_precision = to_numbers("prior_precision", prior_precision, features.dtype)
    noise_precision = to_numbers("noise_precision", noise_precision, features.dtype)
    num_observations, num_features = features.shape
    scale = jnp.sqrt(noise_precision)
    factor, rotated = _triangular(scale * features, scale * targets, prior_precision)
    mean = solve_triangular(factor, rotated)
    residuals = targets - matmul(features, mean)
    error = 0.5 * (noise_precision * jnp.sum(residuals**2) + prior_precision * jnp.sum(mean**2))
    return (
        0.5 * num_features * jnp.log(prior_precision)
        + 0.5 * num_observations * jnp.log(noise_precision / (2.0 * jnp.pi))
        - jnp.sum(jnp.log(jnp.abs(jnp.diagonal(factor))))
        - error
    )


def maximise_evidence(
    features: Float[Array, "N M"] | Numbers, targets: Float[Array, "N"] | Numbers
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The prior precision and the noise precision of highest evidence: type-II maximum likelihood.

    The result is the global maximum over ratios of both precisions from `covariance_floor` to its inverse, in
    units of the mean squared length of a row of features, up to the resolution of a grid of ratios. A maximum
    beyond this range gives the nearer end of the range.

    Raises:
        ValueError: There are no observations.
    """
    features, targets = to_data(features, targets)
    if not len(targets):
        raise ValueError("observations: got 0; allowed: >= 1, since the evidence is constant without any")
    if is_known((features, targets)):
        check_readings(("features", features), ("targets", targets), np.ones(len(targets), bool))
    return _maximise_evidence(features, targets)


@jax.jit
def _maximise_evidence(
    features: Float[Array, "N M"], targets: Float[Array, "N"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    # For a given ratio of the precisions, the best noise variance has a closed form. Substituted into the
    # evidence, it leaves a function of the ratio, which costs O(M) once the singular values of the features
    # are known: a grid of ratios, then bisection on the derivative around the best one. No step size, no
    # starting point.
    num_observations = len(targets)
    floor = covariance_floor(features.dtype)
    u, singular, _ = jnp.linalg.svd(features, full_matrices=False)
    rotated = matmul(targets, u)
    unexplained = jnp.sum((targets - matmul(u, rotated)) ** 2)
    size, power = jnp.mean(targets**2), jnp.sum(singular**2) / num_observations
    least_noise = floor * jnp.where(size > 0.0, size, 1.0)
    power = jnp.where(power > 0.0, power, 1.0)

    def noise_variance(shares):
        """Mean squared residual and best noise variance; `shares` are the shrinkage factors of the prior."""
        residual = (unexplained + jnp.sum(shares * rotated**2)) / num_observations
        return residual, jnp.maximum(residual, least_noise)

    def evidence(log_ratio):
        relative = singular**2 / (power * jnp.exp(log_ratio))
        residual, noise = noise_variance(1.0 / (1.0 + relative))
        data_fit = num_observations * (jnp.log(noise) + residual / noise)
        return -0.5 * (data_fit + jnp.sum(jnp.log1p(relative)))

    def halve(bracket, _):
        middle = jnp.mean(bracket)
        is_rising = jax.grad(evidence)(middle) > 0.0
        low, high = jnp.where(is_rising, middle, bracket[0]), jnp.where(is_rising, bracket[1], middle)
        return jnp.stack([low, high]), None

    log_ratios = jnp.linspace(jnp.log(floor), -jnp.log(floor), NUM_RATIOS, dtype=features.dtype)
    best = jnp.argmax(jax.vmap(evidence)(log_ratios))
    around = log_ratios[jnp.clip(best + jnp.asarray([-1, 1], best.dtype), 0, NUM_RATIOS - 1)]
    bracket, _ = jax.lax.scan(halve, around, length=jnp.finfo(features.dtype).nmant)
    ratio = power * jnp.exp(jnp.mean(bracket))
    noise_precision = 1.0 / noise_variance(ratio / (ratio + singular**2))[1]
    return ratio * noise_precision, noise_precision


def _weights(sample_weight: Any, features: Float[Array, "N M"]) -> Float[Array, "N"]:
    """The weights of observations, 1 by default."""
    if sample_weight is None:
        return jnp.ones((len(features),), features.dtype)
    weight = to_numbers("sample_weight", sample_weight, features.dtype)
    if weight.shape != features.shape[:1]:
        raise ValueError(f"sample_weight: got shape {weight.shape}; allowed: {features.shape[:1]}")
    if is_known(weight) and not np.all(np.isfinite(weight) & (np.asarray(weight) >= 0.0)):
        raise ValueError("sample_weight: got a negative or non-finite number; allowed: finite numbers >= 0")
    return weight


def _triangular(features, targets, prior_precision) -> tuple[Float[Array, "M M"], Float[Array, "M *K"]]:
    """R and Q'[targets; 0], where Q R = [features; sqrt(prior_precision) I]."""
    num_features = features.shape[1]
    prior = jnp.sqrt(prior_precision) * jnp.eye(num_features, dtype=features.dtype)
    q, factor = jnp.linalg.qr(jnp.concatenate([features, prior]))
    return factor, matmul(q[: len(features)].T, targets)


def _symmetric(matrix: Float[Array, "M M"]) -> Float[Array, "M M"]:
    """Average the two triangles: their rounding errors differ, and updates amplify the difference."""
    return 0.5 * (matrix + matrix.T)


def _times_rows(scale: Float[Array, "N"], rows: Float[Array, "N *K"]) -> Float[Array, "N *K"]:
    return jax.vmap(jnp.multiply)(scale, rows)


def _where_seen(sample_weight: Float[Array, "N"], rows: Float[Array, "N *K"]) -> Float[Array, "N *K"]:
    return jax.vmap(lambda weight, row: jnp.where(weight > 0.0, row, 0.0))(sample_weight, rows)
