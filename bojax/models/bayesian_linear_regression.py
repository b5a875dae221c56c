"""Bayesian linear regression: the posterior by batch and by gain, the evidence, and its maximum."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

from bojax.numerics.linalg import covariance_floor, matmul

NUM_RATIOS = 128
"""Ratios of the precisions at which `maximise_evidence` looks before it refines the best of them."""


class BayesianLinearRegression(eqx.Module):
    """The posterior N(mean, covariance) of the weights of a linear model (2.13).

    The covariance is `base - rows' rows`. Without a block (`rows` has none) every update rewrites `base`.
    With one, an update appends a row and only reads `base`, half the memory traffic; `flush` subtracts the
    rows at once, which rounds once where single updates would round `block` times. Whoever updates calls
    `flush`, at least once in `block` updates, or the covariance forgets the oldest of them: a count that is
    the same for every run of a batch needs no branch for each of them.

    The noise variance has a floor, `covariance_floor` times the prior variance phi'phi / alpha of the
    observed value. With less noise, rounding of the covariance would be as large as the predictive variance,
    and updates would diverge. `update` and `row` raise the noise variance of their observation to this floor.
    `fit` and `update_batch` take the largest prior variance of their observations and multiply all noise
    variances by the same factor, so that the relative weights of the observations stay what they are. Where
    feature vectors of unequal length are given one by one and the floor binds, longer ones weigh less.

    Attributes:
        mean: Mean of the weights, a column for each target where several share the features.
        base: Covariance of the weights at the last flush.
        rows: What was learned since then; zero where there is nothing.
        prior_precision: Precision of each weight before any observation: alpha (2.11).
        noise_precision: Precision of the observation noise: beta (2.9).
    """

    mean: Float[Array, "M *K"]
    base: Float[Array, "M M"]
    rows: Float[Array, "B M"]
    prior_precision: Float[Array, ""]
    noise_precision: Float[Array, ""]

    @classmethod
    def prior(
        cls,
        num_features: int,
        prior_precision: Float[Array, ""],
        noise_precision: Float[Array, ""],
        *,
        num_targets: int | None = None,
        block: int = 0,
    ) -> "BayesianLinearRegression":
        """No observation yet (2.11).

        Args:
            num_features: Number of features, the bias among them.
            prior_precision: Precision of each weight.
            noise_precision: Precision of the observation noise.
            num_targets: Number of targets that share the covariance; None for one target, without an axis.
            block: Number of updates between two flushes; 0 applies each of them at once.

        Raises:
            ValueError: A number is too small.
        """
        for name, number, least in (("num_features", num_features, 1), ("block", block, 0)):
            if number < least:
                raise ValueError(f"{name}: got {number}; allowed: >= {least}")
        if num_targets is not None and num_targets < 1:
            raise ValueError(f"num_targets: got {num_targets}; allowed: >= 1 or None")
        dtype = prior_precision.dtype
        targets = () if num_targets is None else (num_targets,)
        return cls(
            mean=jnp.zeros((num_features, *targets), dtype),
            base=jnp.eye(num_features, dtype=dtype) / prior_precision,
            rows=jnp.zeros((block, num_features), dtype),
            prior_precision=prior_precision,
            noise_precision=noise_precision,
        )

    @classmethod
    def fit(
        cls,
        features: Float[Array, "N M"],
        targets: Float[Array, "N *K"],
        prior_precision: Float[Array, ""],
        noise_precision: Float[Array, ""],
        *,
        sample_weight: Float[Array, "N"] | None = None,
        block: int = 0,
    ) -> "BayesianLinearRegression":
        """The posterior given all observations at once (2.14, 2.15); differentiable.

        By the triangular factor of the features with the prior below them, whose condition number is the
        square root of that of the precision matrix.
        The arguments are those of `prior` and `update`.
        """
        num_observations, num_features = features.shape
        prior = cls.prior(num_features, prior_precision, noise_precision, block=block)
        if sample_weight is None:
            sample_weight = jnp.ones((num_observations,), features.dtype)
        features, targets = _where_seen(sample_weight, features), _where_seen(sample_weight, targets)
        scale = jnp.sqrt(prior._precisions(features, sample_weight))
        factor, rotated = _triangular(
            _times_rows(scale, features), _times_rows(scale, targets), prior_precision
        )
        inverse = solve_triangular(factor, jnp.eye(num_features, dtype=factor.dtype))
        return cls(
            mean=matmul(inverse, rotated),
            base=_symmetric(matmul(inverse, inverse.T)),
            rows=prior.rows,
            prior_precision=prior_precision,
            noise_precision=noise_precision,
        )

    @property
    def covariance(self) -> Float[Array, "M M"]:
        """Covariance of the weights (2.15): what `flush` makes of `base`."""
        return _symmetric(self.base - matmul(self.rows.T, self.rows)) if len(self.rows) else self.base

    def covariance_times(self, features: Float[Array, "*N M"]) -> Float[Array, "*N M"]:
        """The covariance times each feature vector, all in one product."""
        product = matmul(features, self.base)
        if len(self.rows):
            product = product - matmul(matmul(features, self.rows.T), self.rows)
        return product

    def row(
        self,
        features: Float[Array, "M"],
        *,
        sample_weight: Float[Array, ""] | None = None,
        product: Float[Array, "M"] | None = None,
    ) -> Float[Array, "M"]:
        """The r of which `update` with the same arguments takes r r' from the covariance (5.22).

        It takes (psi' r)^2 from the variance at any other features psi.
        """
        return self._gain(features, sample_weight, product)[0]

    def update(
        self,
        features: Float[Array, "M"],
        target: Float[Array, "*K"],
        *,
        sample_weight: Float[Array, ""] | None = None,
        product: Float[Array, "M"] | None = None,
        slot: Int[Array, ""] | int | None = None,
    ) -> "BayesianLinearRegression":
        """The posterior after one more observation (2.21, 2.22 as corrected), in gain form (5.22).

        With u = S phi and k = beta u / (1 + beta phi'u): m += k (t - phi'm), S -= k u'. No branch and no
        inverse.

        Args:
            features: Features of the observation.
            target: Observed value, one for each target.
            sample_weight: Precision of this observation, in units of `noise_precision`; 1 if left out. With
                0 it leaves no trace, whatever is in it, but takes a row of the block all the same.
            product: `covariance_times(features)`, for whom has it already.
            slot: The row of the block to take: a count of updates since the flush, from 0 to `block` - 1,
                best one that is the same for every run of a batch. Left out, the rows move up by one, which
                costs 3 to 5% of a step of several hundred features on a GPU.
        """
        row, gain = self._gain(features, sample_weight, product)
        residual = target - matmul(features, self.mean)
        if sample_weight is not None:
            residual = jnp.where(sample_weight > 0.0, residual, 0.0)
        base, rows = self.base, self.rows
        if not len(rows):
            base = base - row[:, None] * row[None, :]
        elif slot is None:
            rows = jnp.concatenate([rows[1:], row[None, :]])
        else:
            rows = jax.lax.dynamic_update_index_in_dim(rows, row, slot, axis=0)
        return self._with(self.mean + jax.vmap(lambda k: k * residual)(gain), base, rows)

    def update_batch(
        self,
        features: Float[Array, "N M"],
        targets: Float[Array, "N *K"],
        *,
        sample_weight: Float[Array, "N"] | None = None,
    ) -> "BayesianLinearRegression":
        """The posterior after several more observations: that of `update` by each of them, in any order.

        In gain form as well: a factor of the size of the batch, none of the size of the model. Takes no row
        of the block.
        """
        if sample_weight is None:
            sample_weight = jnp.ones((len(features),), features.dtype)
        features, targets = _where_seen(sample_weight, features), _where_seen(sample_weight, targets)
        scale = jnp.sqrt(self._precisions(features, sample_weight))
        scaled = _times_rows(scale, features)
        products = self.covariance_times(scaled)
        innovation = matmul(scaled, products.T) + jnp.eye(len(features), dtype=features.dtype)
        factor = jnp.linalg.cholesky(innovation)
        rows = solve_triangular(factor, products, lower=True)
        residuals = _times_rows(scale, targets - matmul(features, self.mean))
        whitened = solve_triangular(factor, residuals, lower=True)
        base = _symmetric(self.base - matmul(rows.T, rows))
        return self._with(self.mean + matmul(rows.T, whitened), base, self.rows)

    def flush(self) -> "BayesianLinearRegression":
        """The same posterior with an empty block."""
        return self._with(self.mean, self.covariance, jnp.zeros_like(self.rows))

    def predict(
        self, features: Float[Array, "N M"], *, with_noise: bool = False
    ) -> tuple[Float[Array, "N *K"], Float[Array, "N"]]:
        """Predictive mean and variance (2.17, 2.18) of the noise-free value, or of an observation.

        The variance is the same for all targets that share the covariance.
        """
        variance = jnp.maximum(jnp.sum(features * self.covariance_times(features), axis=1), 0.0)
        if with_noise:
            variance = variance + 1.0 / self.noise_precision
        return matmul(features, self.mean), variance

    def _gain(self, features, sample_weight, product) -> tuple[Float[Array, "M"], Float[Array, "M"]]:
        """The row that leaves the covariance, and the gain that multiplies the residual."""
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
        """Precisions with which observations are taken that are given together; see the class."""
        precision = sample_weight * self.noise_precision
        return precision / jnp.max(jax.vmap(self._excess)(features, precision), initial=1.0)

    def _excess(self, features, precision) -> Float[Array, ""]:
        """By which factor the noise variance of an observation is below its floor; below 1, it is above."""
        prior_variance = jnp.sum(features * features) / self.prior_precision
        return precision * covariance_floor(features.dtype) * prior_variance

    def _with(self, mean, base, rows) -> "BayesianLinearRegression":
        return BayesianLinearRegression(mean, base, rows, self.prior_precision, self.noise_precision)


def log_marginal_likelihood(
    features: Float[Array, "N M"],
    targets: Float[Array, "N"],
    prior_precision: Float[Array, ""],
    noise_precision: Float[Array, ""],
) -> Float[Array, ""]:
    """Logarithm of the evidence, ln p(t | alpha, beta): the negative of (2.23); differentiable."""
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
    features: Float[Array, "N M"], targets: Float[Array, "N"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The prior precision and the noise precision of highest evidence: type-II maximum likelihood.

    Where the evidence has its maximum, the noise variance is a function of the ratio of the two precisions;
    with it put in, the evidence is a function of that ratio alone, at the price of O(M) once the singular
    values of the features are known. The best of many ratios, from `covariance_floor` to its inverse in units
    of the mean square of a row of features, is refined by bisection on the derivative. So the result is the
    global maximum on that range, without a step size or a start; at either end, it is that end.

    Raises:
        ValueError: There is no observation.
    """
    num_observations = len(targets)
    if not num_observations:
        raise ValueError("observations: got 0; allowed: >= 1, for the evidence says nothing without any")
    floor = covariance_floor(features.dtype)
    u, singular, _ = jnp.linalg.svd(features, full_matrices=False)
    rotated = matmul(targets, u)
    unexplained = jnp.sum((targets - matmul(u, rotated)) ** 2)
    size, power = jnp.mean(targets**2), jnp.sum(singular**2) / num_observations
    least_noise = floor * jnp.where(size > 0.0, size, 1.0)
    power = jnp.where(power > 0.0, power, 1.0)

    def noise_variance(shares):
        """Mean squared residual, and the best noise variance; `shares` is what the prior keeps of each."""
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


def _triangular(features, targets, prior_precision) -> tuple[Float[Array, "M M"], Float[Array, "M *K"]]:
    """R and Q'[targets; 0], where Q R = [features; sqrt(prior_precision) I]."""
    num_features = features.shape[1]
    prior = jnp.sqrt(prior_precision) * jnp.eye(num_features, dtype=features.dtype)
    q, factor = jnp.linalg.qr(jnp.concatenate([features, prior]))
    return factor, matmul(q[: len(features)].T, targets)


def _symmetric(matrix: Float[Array, "M M"]) -> Float[Array, "M M"]:
    """The two triangles of a product differ by rounding, and what differs grows with every update."""
    return 0.5 * (matrix + matrix.T)


def _times_rows(scale: Float[Array, "N"], rows: Float[Array, "N *K"]) -> Float[Array, "N *K"]:
    return jax.vmap(jnp.multiply)(scale, rows)


def _where_seen(sample_weight: Float[Array, "N"], rows: Float[Array, "N *K"]) -> Float[Array, "N *K"]:
    return jax.vmap(lambda weight, row: jnp.where(weight > 0.0, row, 0.0))(sample_weight, rows)
