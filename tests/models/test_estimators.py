"""The estimators within scikit-learn, and the inputs that they refuse."""

import warnings
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from sklearn.base import clone, is_regressor
from sklearn.gaussian_process import GaussianProcessRegressor as Reference
from sklearn.gaussian_process import kernels as sk
from sklearn.metrics import r2_score
from sklearn.model_selection import cross_val_score
from typing_extensions import override

from bojax.models.bayesian_linear_regression import log_marginal_likelihood
from bojax.models.estimators import BayesianLinearRegressor, GaussianProcessRegressor
from bojax.models.features import Polynomial
from bojax.models.kernels import RBF, Kernel, Matern12, Matern32, Matern52, Scaled
from bojax.models.means import ConstantMean, LinearMean
from tests.refusals import assert_refused
from tests.tiers import by_tier

rng = np.random.default_rng(0)
X = rng.uniform(-1.0, 1.0, (20, 2))
Y = np.sin(3.0 * X[:, 0]) + X[:, 1] + 0.05 * rng.normal(size=20)
QUERIES = rng.uniform(-1.0, 1.0, (7, 2))
FIXED = Scaled(RBF(jnp.asarray([0.5, 0.8])), jnp.asarray(2.0))
ESTIMATORS = {
    "gp": GaussianProcessRegressor(FIXED, 0.1, standardise=False, optimise=False),
    "blr": BayesianLinearRegressor(Polynomial(2, 2)),
}
each_estimator = pytest.mark.parametrize("name", ESTIMATORS)


NOISES = rng.uniform(0.01, 1.0, 20)


def test_a_linear_model_warns_of_means_far_from_zero():
    random = np.random.default_rng(0)
    X = random.normal(size=(50, 2))
    y = X @ [1.0, 2.0] + 3.0 + 0.1 * random.normal(size=50)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        BayesianLinearRegressor(dtype="float64").fit(X, y)
        own = BayesianLinearRegressor(Polynomial(1, 2), dtype="float64")
        own.fit(X + 1e3, y)  # features that are given may subtract a mean
    for name, rows, values in (("y", X, y + 1e5), ("X", X + 1e3, y)):
        with pytest.warns(UserWarning, match=f"^{name}: differs little around a mean far from 0"):
            BayesianLinearRegressor(dtype="float64").fit(rows, values)


@pytest.mark.parametrize(
    "kernel, reference, noises",
    [
        (FIXED, 2.0 * sk.RBF([0.5, 0.8]), None),
        (FIXED, 2.0 * sk.RBF([0.5, 0.8]), NOISES),
        ("matern52", 1.0 * sk.Matern([1.0, 1.0], nu=2.5), None),
    ],
    ids=["one noise", "noise of each", "a name"],
)
def test_without_learning_it_is_the_posterior_of_scikit_learn(kernel, reference, noises):
    ours = GaussianProcessRegressor(kernel, standardise=False, optimise=False)
    ours.fit(X, Y, noise_variances=noises)
    reference = Reference(reference, alpha=0.1 if noises is None else noises, optimizer=None).fit(X, Y)
    for found, expected in zip(
        ours.predict(QUERIES, return_std=True), reference.predict(QUERIES, return_std=True), strict=True
    ):
        assert isinstance(found, np.ndarray)
        np.testing.assert_allclose(found, expected, atol=1e-12)
    evidence = reference.log_marginal_likelihood(reference.kernel_.theta)
    np.testing.assert_allclose(ours.log_marginal_likelihood_, evidence, atol=1e-10)
    assert ours.has_converged_ is None and ours.noise_variance_ == 0.1
    assert ours.get_params()["kernel"] is kernel


def test_learning_raises_the_evidence():
    fixed = GaussianProcessRegressor(FIXED, 0.1, standardise=False, optimise=False).fit(X, Y)
    learned = GaussianProcessRegressor(FIXED, 0.1).fit(X, Y)
    assert learned.log_marginal_likelihood_ > fixed.log_marginal_likelihood_ + 1.0
    assert learned.has_converged_ and learned.noise_variance_ < 0.05
    assert learned.score(X, Y) > 0.98
    by_default = GaussianProcessRegressor().fit(X, Y)
    np.testing.assert_allclose(by_default.log_marginal_likelihood_, learned.log_marginal_likelihood_)


UNITS = {
    "unit": (1.0, 0.0, 1.0, 0.0),
    "tens of thousands": (1e4, 0.0, 1.0, 0.0),
    "pascal": (1e5, 0.0, 1.0, 0.0),
    "micrometres": (1e-5, 0.0, 1.0, 0.0),
    "kelvin": (1.0, 290.0, 1.0, 0.0),
    "times in nanoseconds": (1.0, 0.0, 1e8, 0.0),
    "lengths in metres": (1.0, 0.0, 1e-8, 0.0),
    "times since 1970": (1.0, 0.0, 1.0, 1.7e9),
    "all at once": (1e-3, 5.0, 1e4, -3e6),
}
"""Unit and offset of the values, and of the inputs."""


@pytest.mark.parametrize("given_noise", [False, True], ids=["learned noise", "known noise"])
def test_units_do_not_matter_and_results_are_in_the_units_of_the_data(given_noise):
    random = np.random.default_rng(1)
    x, noise = random.uniform(0.0, 10.0, 25), random.normal(size=25)
    queries = np.linspace(0.5, 9.5, 7)
    found = {}
    for name, (unit, offset, x_unit, x_offset) in UNITS.items():
        inputs, values = x * x_unit + x_offset, unit * (np.sin(x) + 0.01 * noise) + offset
        at = (queries * x_unit + x_offset)[:, None]
        known = np.full(25, (0.01 * unit) ** 2) if given_noise else None
        model = GaussianProcessRegressor().fit(inputs[:, None], values, noise_variances=known)
        assert model.has_converged_
        mean, std = model.predict(at, return_std=True)
        error = (mean - offset) / unit - np.sin(queries)
        assert np.sqrt(np.mean(error**2)) < 0.02 and np.all(np.abs(error) < 5.0 * std / unit)
        np.testing.assert_allclose(model.posterior_.predict(at)[0], mean)
        found[name] = [
            *(mean - offset) / unit,
            *(std / unit),
            float(model.kernel_.variance) / unit**2,
            float(model.kernel_.kernel.lengthscale[0]) / x_unit,
            model.noise_variance_ / unit**2 if not given_noise else 0.0,
            (float(model.posterior_.mean.value) - offset) / unit,
            model.log_marginal_likelihood_ + 25 * np.log(unit),
        ]
    for each in found.values():
        np.testing.assert_allclose(each, found["unit"], rtol=2e-3, atol=1e-4)
    reference = Reference(sk.ConstantKernel() * sk.RBF() + sk.WhiteKernel(0.1, (1e-9, 1.0)), normalize_y=True)
    inputs = ((x - x.mean()) / x.std())[:, None]
    reference.fit(inputs, np.sin(x) + 0.01 * noise)
    theirs = reference.predict(((queries - x.mean()) / x.std())[:, None])
    np.testing.assert_allclose(found["unit"][:7], theirs, atol=5e-3)


def test_settings_are_in_units_of_the_standardised_data():
    scaled = GaussianProcessRegressor(FIXED, 0.1, optimise=False).fit(1e3 * X - 7.0, 1e-4 * Y + 3.0)
    centred, unit = (X - X.mean(axis=0)) / X.std(axis=0), Y.std()
    reference = Reference(2.0 * sk.RBF([0.5, 0.8]), alpha=0.1, optimizer=None, normalize_y=True)
    reference.fit(centred, 1e-4 * Y + 3.0)
    queries = (QUERIES - X.mean(axis=0)) / X.std(axis=0)
    expected = reference.predict(queries, return_std=True)
    for ours, theirs in zip(scaled.predict(1e3 * QUERIES - 7.0, return_std=True), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)
    np.testing.assert_allclose(scaled.kernel_.kernel.lengthscale, 1e3 * X.std(axis=0) * [0.5, 0.8])
    np.testing.assert_allclose(scaled.kernel_.variance, 2.0 * (1e-4 * unit) ** 2)
    np.testing.assert_allclose(scaled.noise_variance_, 0.1 * (1e-4 * unit) ** 2)
    plain = GaussianProcessRegressor(FIXED, 0.1, optimise=False, mean=ConstantMean(3.0))
    plain.fit(1e3 * X - 7.0, 1e-4 * Y + 3.0)
    rms = np.sqrt(np.mean((1e-4 * Y) ** 2))
    np.testing.assert_allclose(plain.kernel_.variance, 2.0 * rms**2)
    assert plain.posterior_.mean.value == 3.0


def test_a_hyper_parameter_at_a_bound_is_named_and_nothing_has_converged():
    line = np.linspace(-1.0, 1.0, 20)
    for x, y, settings, names in (
        (line, 1e5 * np.sin(3.0 * line) + 100.0 * Y, {"standardise": False}, r"kernel\.variance.*"),
        (line, np.sin(3.0 * line), {}, "noise_variance"),
    ):
        with pytest.warns(UserWarning, match=f"{names}: at a bound of the search"):
            model = GaussianProcessRegressor(**settings).fit(x[:, None], y)
        assert model.has_converged_ is False
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert GaussianProcessRegressor().fit(X, Y).has_converged_


def test_constant_columns_and_targets_have_unit_scale():
    x = np.stack([X[:, 0], np.full(20, 0.1)], axis=1)
    model = GaussianProcessRegressor(optimise=False).fit(x, np.full(20, 0.1))
    np.testing.assert_allclose(model.predict(x), 0.1)
    assert model.kernel_.variance == 1.0 and model.kernel_.kernel.lengthscale[1] == 1.0


@pytest.mark.parametrize("estimator", [GaussianProcessRegressor, BayesianLinearRegressor])
def test_float32_refuses_numbers_that_it_does_not_resolve(estimator):
    for x, y, name in ((X + 1.7e9, Y, "X"), (X, Y + 1e7, "y")):
        with pytest.raises(ValueError, match=f"{name}: float32 does not resolve values that differ by"):
            estimator(dtype="float32").fit(x, y)


def test_a_linear_model_learns_both_precisions():
    y = 2.0 * X[:, 0] - X[:, 1] + 0.5 + 0.01 * rng.normal(size=20)
    learned = BayesianLinearRegressor().fit(X, y)
    mean, std = learned.predict(QUERIES, return_std=True)
    np.testing.assert_allclose(mean, 2.0 * QUERIES[:, 0] - QUERIES[:, 1] + 0.5, atol=0.03)
    assert np.all((std > 0.0) & (std < 0.02))
    design = Polynomial(1, 2).design(jnp.asarray(X))
    for factor in (0.8, 1.25):
        for precisions in ((factor, 1.0), (1.0, factor)):
            prior, noise = np.multiply(precisions, (learned.prior_precision_, learned.noise_precision_))
            other = jax.jit(log_marginal_likelihood)(design, y, prior, noise)
            assert other < learned.log_marginal_likelihood_


@each_estimator
def test_does_what_scikit_learn_asks_of_an_estimator(name):
    estimator = ESTIMATORS[name]
    assert is_regressor(estimator)
    copy = clone(estimator)
    assert copy is not estimator and copy.get_params().keys() == estimator.get_params().keys()
    assert not hasattr(copy, "posterior_")
    assert copy.set_params(optimise=False) is copy and copy.get_params()["optimise"] is False
    scores = cross_val_score(estimator, X, Y, cv=2)
    assert np.all(scores > 0.2)
    fitted = clone(estimator).fit(X[:10], Y[:10])
    predicted = fitted.predict(X[10:])
    np.testing.assert_allclose(fitted.score(X[10:], Y[10:]), r2_score(Y[10:], predicted), rtol=1e-12)
    ones = np.ones(10)  # scikit-learn scores a constant with 0
    assert fitted.score(X[10:], ones) == r2_score(ones, predicted) == 0.0
    with pytest.raises(ValueError, match="kernl: unknown; allowed: "):
        copy.set_params(kernl=1)


@each_estimator
def test_without_rows_it_predicts_the_prior(name):
    mean, std = ESTIMATORS[name].fit(X[:0], Y[:0]).predict(QUERIES, return_std=True)
    np.testing.assert_array_equal(mean, 0.0)
    expected = {"gp": np.full(7, 2.0**0.5), "blr": np.sqrt(np.sum(design_of(QUERIES) ** 2, axis=1))}
    np.testing.assert_allclose(std, expected[name], rtol=1e-12)


def design_of(x: np.ndarray) -> np.ndarray:
    """All products of at most two coordinates."""
    one, a, b = np.ones(len(x)), x[:, 0], x[:, 1]
    return np.stack([one, a, b, a * a, a * b, b * b], axis=1)


@each_estimator
def test_refuses_data_that_are_no_data(name):
    not_numbers, sums = "X: not an array of numbers: ", "for finite sums of squares in float64"
    too_large = rf"got .*e\+..+; allowed: up to 1.3e\+150, {sums}"
    fitted = clone(ESTIMATORS[name]).fit(X, Y)
    assert_refused(
        [
            (lambda x=x, y=y: clone(ESTIMATORS[name]).fit(x, y), message)
            for x, y, message in (
                (X, np.where(np.arange(20) == 3, np.nan, Y), "y: 1 of 20 numbers are not finite"),
                (np.where(X > 0.9, np.inf, X), Y, "X: .* of 40 numbers are not finite"),
                (X, Y[:5], "y: got 5 numbers; allowed: 20, one for each row of X"),
                (X[:, 0], Y, r"X: got shape \(20,\); allowed: \[rows, columns\]"),
                (X, Y[:, None], r"y: got shape \(20, 1\); allowed: \[rows\]"),
                ([["a", "b"]], [1.0], not_numbers),
                (X + 0j, Y, not_numbers + "complex or masked values"),
                (np.ma.masked_array(X, X > 0.5), Y, not_numbers + "complex or masked values"),
                (1e300 * X, Y, f"X: {too_large}"),
                (X, -1e300 * Y, f"y: {too_large}"),
            )
        ]
    )
    unfitted = clone(ESTIMATORS[name])
    assert_refused(
        [
            (lambda: unfitted.predict(QUERIES), "has not been fitted: call fit first"),
            (lambda: fitted.predict(QUERIES[:, :1]), "X: got 1 columns; allowed: 2, as in fit"),
        ]
    )


class Own(Kernel):
    """A kernel of a user's own; any function, whether it is a covariance or not."""

    function: Callable[[Array, Array], Array] = eqx.field(static=True)

    @override
    def __call__(self, x, y):
        return self.function(x, y)


def test_a_kernel_of_brownian_motion_is_no_mistake():
    kernel = Own(lambda x, y: jnp.prod(jnp.minimum(x, y)))
    GaussianProcessRegressor(kernel, optimise=False).fit(np.abs(X), Y)


def test_refuses_settings_that_cannot_be():
    # Not by the constructor, whose annotations are checked first.
    columns = r"does not accept points of dimension 2 \(the columns of X\)"
    noise, precision = "a number >= 0", "allowed: a number > 0"
    process = [
        ({"kernel": RBF(jnp.asarray(0.0))}, "kernel.lengthscale: got 0; allowed: > 0"),
        ({"kernel": Scaled(RBF(jnp.ones(2)), jnp.asarray(-1.0))}, "kernel.variance: got -1; allowed: > 0"),
        ({"kernel": RBF(jnp.asarray([1.0, jnp.nan]))}, "kernel.lengthscale: got a number that is not finite"),
        ({"kernel": RBF(jnp.ones(3))}, f"kernel: {columns}"),
        ({"mean": LinearMean(jnp.ones(3), jnp.asarray(0.0))}, f"mean: {columns}"),
        ({"mean": ConstantMean(jnp.asarray(jnp.inf))}, "mean.value: got a number that is not finite"),
        ({"kernel": "rfb"}, 'kernel: got "rfb"; unknown kernel; .*did you mean "rbf"'),
        ({"kernel": "sum"}, "kernel.lengthscale: unknown key .*rbf"),
        ({"kernel": {"kind": "rbf", "lengthscale": 0}}, "kernel.lengthscale: got 0; allowed: a number from"),
        (
            {"kernel": Own(lambda x, y: jnp.log(-1.0 - x @ y))},
            "kernel: Own: no covariance of two points is finite",
        ),
        ({"kernel": Own(lambda x, y: jnp.sum(x))}, r"kernel: Own: k\(x, y\) differs from k\(y, x\)"),
        ({"kernel": Own(lambda x, y: -(x @ y))}, "kernel: Own: .* have the eigenvalue -.*; allowed: no neg"),
        ({"kernel": RBF}, "kernel: got <class .*; allowed: an instance of Kernel, such as RBF"),
        ({"mean": 0.0}, "mean: got 0.0; allowed: an instance of Mean, such as ConstantMean"),
        ({"noise_variance": -0.1}, f"noise_variance: got -0.1; allowed: {noise}, representable in float64"),
        ({"noise_variance": float("nan")}, f"noise_variance: got nan; allowed: {noise}"),
        ({"noise_variance": "0.1"}, f'noise_variance: got "0.1"; allowed: {noise}'),
        ({"noise_variance": [0.1]}, rf"noise_variance: got \[0.1\]; allowed: {noise}"),
        ({"noise_variance": 1e39, "dtype": "float32"}, "got 1e.39; allowed: .* representable in float32"),
        ({"optimise": "no"}, 'optimise: got "no"; allowed: True or False'),
        ({"num_starts": 0}, "num_starts: got 0; allowed: an integer >= 1"),
        ({"num_steps": 2.5}, "num_steps: got 2.5; allowed: an integer >= 1"),
        ({"seed": None}, "seed: got None; allowed: an integer >= 0"),
        ({"dtype": "float16"}, 'dtype: got "float16"; allowed: "float64", "float32" or None'),
    ]
    line = [
        ({"prior_precision": 0.0}, f"prior_precision: got 0.0; {precision}, representable in float64"),
        ({"features": Polynomial(1, 3)}, "features: does not accept points of dimension 2"),
        ({"features": "poly"}, 'features: got "poly"; allowed: an instance of Features'),
        ({"noise_precision": None}, f"noise_precision: got None; {precision}"),
        ({"prior_precision": 1e-60, "dtype": "float32"}, "got 1e-60; allowed: .* representable in float32"),
        ({"optimise": 1}, "optimise: got 1; allowed: True or False"),
    ]
    for make, settings in ((GaussianProcessRegressor, process), (BayesianLinearRegressor, line)):
        assert_refused(
            (lambda m=make, s=s: m().set_params(**s).fit(X, Y), message) for s, message in settings
        )
    overflow = r"features of X: got .*e\+23; allowed: up to 1.8e\+15, for finite sums of squares in float32"
    single = clone(ESTIMATORS["blr"]).set_params(dtype="float32")
    assert_refused(
        [
            (lambda: single.fit(1e12 * X, Y), overflow),
            (lambda: single.fit(X, Y).predict(1e12 * X), overflow),
            (
                lambda: GaussianProcessRegressor().fit(X, Y, noise_variances=-np.ones(20)),
                "noise_variances: got -1; allowed: >= 0",
            ),
        ]
    )


def test_the_precision_is_asked_for():
    for name in ("float32", "float64"):
        fitted = GaussianProcessRegressor(FIXED, optimise=False, dtype=name).fit(X, Y)
        assert fitted.posterior_.inverse_cholesky.dtype == name
    with jax.enable_x64(False), pytest.raises(ValueError, match='dtype: got "float64"; JAX runs without'):
        GaussianProcessRegressor(dtype="float64").fit(X, Y)


def test_a_kernel_of_python_numbers_is_learned_like_one_of_arrays():
    ours, theirs = (
        GaussianProcessRegressor(kernel).fit(X, Y) for kernel in (Scaled(RBF([0.5, 0.8]), 2), FIXED)
    )
    assert ours.noise_variance_ == theirs.noise_variance_ != 0.1
    np.testing.assert_array_equal(ours.predict(QUERIES), theirs.predict(QUERIES))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("kernel", by_tier([RBF, Matern12, Matern32, Matern52], normal=[RBF, Matern12]))
@pytest.mark.parametrize("lengthscale", [1e-12, 1e12])
@pytest.mark.parametrize("variance", [1e-12, 1e12])
def test_extreme_kernels_without_noise_predict_numbers(dtype, kernel, lengthscale, variance):
    x = np.concatenate([X, X])  # every point twice
    kernel, settings = Scaled(kernel(lengthscale), variance), {"standardise": False, "optimise": False}
    gp = GaussianProcessRegressor(kernel, 0.0, dtype=dtype, **settings)
    scale = variance**0.5
    mean, std = gp.fit(x, scale * np.concatenate([Y, Y])).predict(
        np.concatenate([X, 1e9 * X]), return_std=True
    )
    assert np.all(np.isfinite(mean)) and np.all(std <= 1.001 * scale)
    assert np.isfinite(gp.log_marginal_likelihood_)
    if lengthscale < 1.0:
        np.testing.assert_allclose(mean[:20] / scale, Y, atol=2e-3)
        np.testing.assert_array_equal(mean[20:], 0.0)
    else:
        np.testing.assert_allclose(mean[:20] / scale, np.mean(Y), atol=2e-2)


@each_estimator
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("size", [1e-300, 1e-7, 1e7])
def test_inputs_and_values_of_extreme_size_are_answered_with_numbers(name, dtype, size):
    for x, y in ((size * X, Y), (X, size * Y), (X[:1], size * Y[:1]), (np.tile(X[:1], (20, 1)), size * Y)):
        fitted = clone(ESTIMATORS[name]).set_params(dtype=dtype).fit(x, y)
        mean, std = fitted.predict(x, return_std=True)
        assert np.all(np.isfinite(mean)) and np.all(np.isfinite(std)) and np.isfinite(fitted.score(x, y))
