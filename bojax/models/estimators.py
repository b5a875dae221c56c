"""Estimators with the interface of scikit-learn, from NumPy arrays to NumPy arrays, checked on the host."""

import abc
import inspect
import warnings
from dataclasses import KW_ONLY, dataclass
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from typing_extensions import override

from bojax.models.bayesian_linear_regression import (
    BayesianLinearRegression,
    log_marginal_likelihood,
    maximise_evidence,
)
from bojax.models.checks import (
    cast,
    check_array,
    check_count,
    check_finite,
    check_flag,
    check_kind,
    check_number,
    check_positive,
    check_takes,
)
from bojax.models.evidence import Optimum, relearn
from bojax.models.features import Features, Polynomial
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel, KernelName, Scaled, as_kernel
from bojax.models.means import ConstantMean, Mean, ZeroMean

Regressor = TypeVar("Regressor", bound="_Regressor")


class _Regressor(abc.ABC):
    """Common parts of the estimators: `get_params`, `set_params`, `score`, and the checks of their data."""

    dtype: str | None
    _fitted_dtype: str  # precision of the posterior

    def predict(self, X: Any, return_std: bool = False) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Posterior mean, and standard deviation of the noise-free value, at the rows of X.

        Raises:
            ValueError: The estimator has not been fitted, or X has another number of columns than in `fit`.
        """
        mean, variance = self._moments(self._queries(X))
        return (np.asarray(mean), np.sqrt(np.asarray(variance))) if return_std else np.asarray(mean)

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The arguments of the constructor, as they were given."""
        return {name: getattr(self, name) for name in inspect.signature(type(self)).parameters}

    def set_params(self: Regressor, **params: Any) -> Regressor:
        """Change arguments of the constructor; the change takes effect at the next `fit`.

        Raises:
            ValueError: There is no such argument.
        """
        names = inspect.signature(type(self)).parameters
        for name, value in params.items():
            if name not in names:
                raise ValueError(f"{name}: unknown; allowed: {', '.join(names)}")
            setattr(self, name, value)
        return self

    def score(self, X: Any, y: Any) -> float:
        """R^2, the share of the variance of `y` that the predicted means explain."""
        mean = self.predict(X)
        y = _vector("y", y, len(mean), "float64")
        residual, total = np.sum((y - mean) ** 2), np.sum((y - np.mean(y)) ** 2)
        if total == 0.0:
            return 1.0 if residual == 0.0 else 0.0
        return float(1.0 - residual / total)

    def __sklearn_tags__(self) -> Any:
        # Only scikit-learn calls this method: bojax does not depend on scikit-learn.
        from sklearn.utils import RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor", target_tags=TargetTags(required=True), regressor_tags=RegressorTags()
        )

    @override
    def __repr__(self) -> str:
        settings = ", ".join(f"{name}={value}" for name, value in self.get_params().items())
        return f"{type(self).__name__}({settings})"

    def _data(self, X: Any, y: Any, dtype: str) -> tuple[np.ndarray, np.ndarray]:
        X = _matrix(X, dtype)
        self.n_features_in_ = X.shape[1]
        return X, _vector("y", y, len(X), dtype)

    def _queries(self, X: Any) -> np.ndarray:
        if not hasattr(self, "posterior_"):
            raise ValueError(f"{type(self).__name__} has not been fitted: call fit first")
        X = _matrix(X, self._fitted_dtype)
        if X.shape[1] != self.n_features_in_:
            raise ValueError(f"X: got {X.shape[1]} columns; allowed: {self.n_features_in_}, as in fit")
        return X

    @abc.abstractmethod
    def _moments(self, X: np.ndarray) -> tuple[jax.Array, jax.Array]:
        """Posterior mean and variance at the rows of X, which have been checked."""

    def _dtype(self) -> str:
        has_float64 = jax.dtypes.canonicalize_dtype(np.float64) == np.float64
        if self.dtype is None:
            return "float64" if has_float64 else "float32"
        if not isinstance(self.dtype, str) or self.dtype not in ("float64", "float32"):
            raise ValueError(f'dtype: got "{self.dtype}"; allowed: "float64", "float32" or None')
        if self.dtype == "float64" and not has_float64:
            raise ValueError(
                'dtype: got "float64"; JAX runs without 64-bit numbers: '
                'call jax.config.update("jax_enable_x64", True) first, or set dtype to "float32"'
            )
        return self.dtype


@dataclass(repr=False, eq=False)
class GaussianProcessRegressor(_Regressor):
    """Gaussian process regression (2.28-2.30) with the interface of scikit-learn.

    `fit` sets `posterior_` (the `GaussianProcess`), `kernel_`, `noise_variance_`, `log_marginal_likelihood_`
    and `has_converged_` (None if nothing is learned). All of them, and all predictions, are in the units of
    the data.

    If a hyper-parameter ends at a bound of the search, 1e-6 or 1e6 in the units of the arguments, `fit`
    warns, and `has_converged_` is False.

    Args:
        kernel: Prior covariance. The name of a stationary kernel, such as `"matern52"`, means this kernel
            with a lengthscale of 1 for each column, scaled by a variance of 1. The hyper-parameters are the
            first starting point of the search, or are kept if nothing is learned.
        noise_variance: Variance of the observation noise, treated like the hyper-parameters of the kernel.
        mean: Prior mean, in the units of the data, which is not learned; by default a learned constant. If
            nothing is learned, the default is the mean value of standardised targets, and otherwise zero.
        standardise: Whether `kernel` and `noise_variance` are given in units of standardised data, as in
            BoTorch and in scikit-learn with `normalize_y`: a lengthscale in standard deviations of the
            column, a variance in the variance of the targets. Otherwise they are in the units of the data,
            which should then have a magnitude near 1.
        optimise: Whether `fit` learns the kernel's hyper-parameters and the noise variance
            (`evidence.relearn`).
        num_starts: Number of starting points of the search.
        num_steps: Maximum number of steps from each starting point.
        seed: Seed of the starting points after the first.
        dtype: `"float64"` or `"float32"`; by default the default precision of JAX.
    """

    kernel: Kernel | KernelName = "rbf"
    noise_variance: float = 0.1
    mean: Mean | None = None
    _: KW_ONLY
    standardise: bool = True
    optimise: bool = True
    num_starts: int = 8
    num_steps: int = 50
    seed: int = 0
    dtype: str | None = None

    def fit(self, X: Any, y: Any, noise_variances: Any = None) -> "GaussianProcessRegressor":
        """Compute the posterior given the rows of X and their values; without rows, it is the prior.

        Args:
            X: Inputs, one in each row.
            y: Observed values.
            noise_variances: Noise variance of each observation, in the units of the data, instead of
                `noise_variance`; these are not learned.

        Raises:
            ValueError: An argument is not finite, not positive or of the wrong shape, or float32 does not
                resolve the differences within a column or the targets.
        """
        dtype = self._dtype()
        X, y = self._data(X, y, dtype)
        number, num_dims = X.shape
        kernel = self.kernel
        if isinstance(kernel, str):
            kernel = Scaled(as_kernel({"kind": kernel, "lengthscale": [1.0] * num_dims}), 1.0)
        kernel = as_kernel(kernel)
        mean = ZeroMean() if self.mean is None else self.mean
        check_kind("mean", mean, Mean, "ConstantMean(1.0)")
        has_own_mean = self.mean is not None
        kernel, mean = cast(kernel, dtype), cast(mean, dtype)
        check_positive("kernel", kernel)
        check_finite("mean", mean)
        check_takes("kernel", kernel, 2, num_dims, dtype)
        check_takes("mean", mean, 1, num_dims, dtype)
        noise_variance = check_number("noise_variance", self.noise_variance, dtype)
        is_standardised = check_flag("standardise", self.standardise)
        is_learned = check_flag("optimise", self.optimise)
        num_starts = check_count("num_starts", self.num_starts, 1)
        num_steps = check_count("num_steps", self.num_steps, 1)
        seed = check_count("seed", self.seed, 0)
        if noise_variances is not None:
            noise_variances = _vector("noise_variances", noise_variances, number, dtype)
            if np.any(noise_variances < 0.0):
                raise ValueError(f"noise_variances: got {noise_variances.min():g}; allowed: >= 0")
        _check_resolved("X", X, dtype)
        _check_resolved("y", y, dtype)
        residuals = y - np.asarray(_prior_means(mean, jnp.asarray(X, dtype)), np.float64)
        # Learned in standardised units, the posterior is then fitted to the data as given: a kernel of
        # standardised inputs is one of the inputs with stretched lengthscales, and variances scale with the
        # square of the unit.
        (centre, unit), (x_centre, x_unit) = (0.0, 1.0), (0.0, np.ones(()))
        if is_standardised and number:
            x_centre, x_unit = np.mean(X, axis=0), _magnitude(X, np.mean(X, axis=0))
            centre = 0.0 if has_own_mean else float(np.mean(residuals))
            unit = float(_magnitude(residuals, centre))
        fitted = _fit(
            kernel,
            jnp.asarray(noise_variance, dtype),
            jnp.asarray(_padded((X - x_centre) / x_unit), dtype),
            jnp.asarray(_padded((residuals - centre) / unit), dtype),
            count=jnp.asarray(number, jnp.int32),
            noise_variances=_given(noise_variances, unit, dtype),
        )
        self.has_converged_ = None
        if is_learned:
            fitted, optimum = relearn(
                fitted,
                jax.random.key(seed),
                learn_mean=not has_own_mean,
                noise_variances=_given(noise_variances, unit, dtype),
                num_starts=num_starts,
                num_steps=num_steps,
            )
            self.has_converged_ = bool(optimum.has_converged)
            _warn_of_bounds(optimum)
        kernel, noise_variance = fitted.kernel, float(fitted.noise_variance)
        if not has_own_mean and number and (is_learned or is_standardised):
            learned = float(fitted.mean(fitted.x[0]))
            mean = ConstantMean(jnp.asarray(centre + unit * learned, dtype))
        if is_standardised:
            same = np.all(x_unit == np.max(x_unit))
            kernel = kernel.stretched(jnp.asarray(np.max(x_unit) if same else x_unit, dtype))
            kernel = kernel.scaled(jnp.asarray(unit, dtype) ** 2)
            check_positive("kernel_", kernel)
            noise_variance = noise_variance * unit**2
        posterior = GaussianProcess.fit(
            kernel,
            jnp.asarray(noise_variance, dtype),
            jnp.asarray(_padded(X), dtype),
            jnp.asarray(_padded(y), dtype),
            mean=mean,
            count=jnp.asarray(number, jnp.int32),
            noise_variances=_given(noise_variances, 1.0, dtype),
        )
        self.posterior_, self._fitted_dtype = posterior, dtype
        self.kernel_ = posterior.kernel
        self.noise_variance_ = float(posterior.noise_variance)
        self.log_marginal_likelihood_ = float(_evidence(posterior))
        return self

    @override
    def _moments(self, X: np.ndarray) -> tuple[jax.Array, jax.Array]:
        return _predict(self.posterior_, jnp.asarray(X, self.posterior_.x.dtype))


@dataclass(repr=False, eq=False)
class BayesianLinearRegressor(_Regressor):
    """Bayesian linear regression on features (2.14-2.18) with the interface of scikit-learn.

    `fit` sets `posterior_` (the `BayesianLinearRegression`), `features_`, `prior_precision_`,
    `noise_precision_` and `log_marginal_likelihood_` (2.23).

    Args:
        features: Feature map; by default the coordinates of the input and a constant.
        prior_precision: Precision of each weight.
        noise_precision: Precision of the observation noise.
        optimise: Whether `fit` learns both precisions by type-II maximum likelihood. Without rows both
            stay as given; values that are all zero determine neither.
        dtype: `"float64"` or `"float32"`; by default the default precision of JAX.
    """

    features: Features | None = None
    prior_precision: float = 1.0
    noise_precision: float = 1.0
    _: KW_ONLY
    optimise: bool = True
    dtype: str | None = None

    def fit(self, X: Any, y: Any) -> "BayesianLinearRegressor":
        """Compute the posterior of the weights given the rows of X and their values.

        Raises:
            ValueError: An argument is not finite, not positive or of the wrong shape, or float32 does not
                resolve the differences within a column or the targets.
        """
        dtype = self._dtype()
        X, y = self._data(X, y, dtype)
        _check_resolved("X", X, dtype)
        _check_resolved("y", y, dtype)
        features = Polynomial(1, X.shape[1]) if self.features is None else self.features
        check_kind("features", features, Features, "Polynomial(2, num_dims=1)")
        features = cast(features, dtype)
        check_finite("features", features)
        check_takes("features", features, 1, X.shape[1], dtype, is_number=False)
        is_learned = check_flag("optimise", self.optimise)
        _warn_of_offsets(y=y, **({"X": X} if self.features is None else {}))
        precisions = tuple(
            jnp.asarray(check_number(name, getattr(self, name), dtype, is_above=True), dtype)
            for name in ("prior_precision", "noise_precision")
        )
        design, y = _design(features, X, dtype), jnp.asarray(y, dtype)
        if is_learned and len(X):
            precisions = maximise_evidence(design, y)
        self.features_ = features
        self.posterior_, self._fitted_dtype = _fit_linear(design, y, *precisions), dtype
        self.prior_precision_, self.noise_precision_ = map(float, precisions)
        self.log_marginal_likelihood_ = float(_evidence_linear(design, y, *precisions))
        return self

    @override
    def _moments(self, X: np.ndarray) -> tuple[jax.Array, jax.Array]:
        return _predict(self.posterior_, _design(self.features_, X, self._fitted_dtype))


_fit = eqx.filter_jit(GaussianProcess.fit)
_prior_means = eqx.filter_jit(lambda mean, xs: jax.vmap(mean)(xs))
_evidence = eqx.filter_jit(GaussianProcess.log_marginal_likelihood)
_fit_linear = jax.jit(BayesianLinearRegression.fit)
_evidence_linear = jax.jit(log_marginal_likelihood)
_predict = eqx.filter_jit(lambda posterior, xs: posterior.predict(xs))
_features = eqx.filter_jit(lambda features, xs: features.design(xs))


def _matrix(X: Any, dtype: str) -> np.ndarray:
    return check_array("X", X, 2, "[rows, columns]", dtype)


def _vector(name: str, values: Any, length: int, dtype: str) -> np.ndarray:
    vector = check_array(name, values, 1, "[rows]", dtype)
    if len(vector) != length:
        raise ValueError(f"{name}: got {len(vector)} numbers; allowed: {length}, one for each row of X")
    return vector


def _design(features: Features, X: np.ndarray, dtype: str) -> jax.Array:
    design = _features(features, jnp.asarray(X, dtype))
    check_array("features of X", design, 2, "[rows, features]", dtype)
    return design


def _padded(rows: np.ndarray) -> np.ndarray:
    """The rows, or one row of zeros if there are none: the capacity of a posterior is at least 1."""
    return rows if len(rows) else np.zeros((1, *rows.shape[1:]))


def _given(noise_variances: np.ndarray | None, unit: float, dtype: str) -> jax.Array | None:
    """Noise variances of each observation, for values in other units."""
    return None if noise_variances is None else jnp.asarray(_padded(noise_variances / unit**2), dtype)


def _magnitude(values: np.ndarray, centre: np.ndarray | float) -> np.ndarray:
    """Root mean square deviation along the first axis; 1 where it is 0 but for rounding."""
    away = np.abs(values - centre)
    scale = np.max(away, axis=0)
    is_constant = scale <= 8.0 * np.finfo(np.float64).eps * np.max(np.abs(values), axis=0)
    scale = np.where(is_constant, 1.0, scale)  # without it, squares could underflow
    return np.where(is_constant, 1.0, scale * np.sqrt(np.mean((away / scale) ** 2, axis=0)))


def _check_resolved(name: str, values: np.ndarray, dtype: str) -> None:
    """Refuse numbers whose differences are lost in the precision, such as times since 1970 in float32."""
    lost = np.finfo(dtype).eps * np.max(np.abs(values), axis=0, initial=0.0)
    spread = np.ptp(values, axis=0) if len(values) else np.zeros(values.shape[1:])
    if np.any((spread > 0.0) & (lost > 1e-4 * spread)):
        raise ValueError(
            f"{name}: {dtype} does not resolve values that differ by {np.min(spread[spread > 0.0]):g} around "
            f'{np.mean(values):g}: subtract an offset, or set dtype to "float64"'
        )


def _warn_of_offsets(**columns: np.ndarray) -> None:
    """Name values far from 0 beside their spread: the weight of the constant has the prior of all others."""
    for name, values in columns.items():
        centre = np.mean(values, axis=0) if len(values) else 0.0
        if len(values) and np.any(np.abs(centre) > 100.0 * _magnitude(values, centre)):
            warnings.warn(
                f"{name}: differs little around a mean far from 0, which one prior of the weights misfits: "
                "subtract the mean",
                stacklevel=3,
            )


def _warn_of_bounds(optimum: Optimum) -> None:
    """Name the hyper-parameters at a bound of the search."""
    names = ("kernel", "noise_variance")
    found = [
        f"{name}{jax.tree_util.keystr(path)}"
        for name, tree in zip(names, optimum.is_at_bound, strict=True)
        for path, is_at_bound in jax.tree_util.tree_leaves_with_path(tree)
        if np.any(is_at_bound)
    ]
    if found:
        warnings.warn(
            f"{', '.join(found)}: at a bound of the search, beyond which a better value may lie", stacklevel=3
        )
