"""Feature maps: random Fourier features against their kernels, the others against scikit-learn."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.preprocessing import PolynomialFeatures

from bojax.models.features import FourierBasis, Polynomial, RadialBasis, RandomFourier
from bojax.models.kernels import RBF, Kernel, Matern12, Matern32, Matern52, Scaled
from tests.refusals import assert_refused
from tests.tiers import by_tier


def number(value) -> jax.Array:
    return jnp.asarray(value, jnp.float64)


def kernels() -> dict[str, Kernel]:
    one, two, each = number(0.5), number(1.0), number([0.4, 1.5])
    return {
        "rbf": RBF(one),
        "rbf-each": RBF(each),
        "matern12": Matern12(one),
        "matern32": Matern32(one),
        "matern52": Matern52(one),
        "matern52-each": Matern52(each),
        "scaled": Scaled(RBF(one), number(3.0)),
        "sum": RBF(two) + Scaled(Matern32(one), number(0.3)),
        "product": RBF(one) * Matern52(two),
        "nested": Scaled((RBF(one) + Matern52(two)) * Matern32(each), number(2.0)),
    }


KERNELS = tuple(kernels())
RATES = ("rbf", "matern12", "sum", "product")
SAMPLINGS = ("monte-carlo", "quasi-random")
SIZES = (32, 512)
POINTS = jnp.asarray(np.random.default_rng(0).uniform(-1.0, 1.0, (25, 2)))


@eqx.filter_jit
def drawn(keys, kernel, num_features, num_dims, sampling):
    """Features of each key."""
    return jax.vmap(lambda key: RandomFourier.draw(key, kernel, num_features, num_dims, sampling=sampling))(
        keys
    )


@eqx.filter_jit
def error(keys, kernel, num_features, sampling):
    """Root mean square error of phi(x)'phi(y) over pairs of points and keys."""
    design = jax.vmap(lambda one: one.design(POINTS))(drawn(keys, kernel, num_features, 2, sampling))
    gram = jax.vmap(lambda one: one @ one.T)(design)
    return jnp.sqrt(jnp.mean((gram - kernel.gram(POINTS, POINTS)[None]) ** 2))


@functools.cache
def errors(name: str, sampling: str) -> np.ndarray:
    """The error for each size, over 24 keys."""
    keys = (jax.random.split(jax.random.key(size), 24) for size in SIZES)
    return np.asarray(
        [error(k, kernels()[name], size, sampling) for k, size in zip(keys, SIZES, strict=True)]
    )


def slope(name: str, sampling: str) -> float:
    """Power of the number of features with which the error falls."""
    return np.polyfit(np.log(SIZES), np.log(errors(name, sampling)), 1)[0]


@pytest.mark.parametrize("name", by_tier(RATES, normal=["sum"]))
def test_the_error_falls_with_the_number_of_features(name):
    # Over other keys the slope has a standard deviation of 0.05.
    assert -0.62 < slope(name, "monte-carlo") < -0.38
    # An average of M/2 cosines, of variance at most 1 each, for every term of unit variance.
    kernel = kernels()[name]
    bound = kernel(POINTS[0], POINTS[0]) / np.sqrt(np.asarray(SIZES) / 2)
    assert np.all(errors(name, "monte-carlo") < bound)
    # Of quasi-random frequencies, 512 have 0.70 (Matern 1/2) to 0.23 (squared exponential) times the error.
    assert errors(name, "quasi-random")[1] < 0.8 * errors(name, "monte-carlo")[1]
    assert slope(name, "quasi-random") < slope(name, "monte-carlo") - 0.05
    if name == "rbf":  # the smoothest integrand, with the fewest variables
        assert slope(name, "quasi-random") < -0.8


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("name", by_tier(KERNELS, normal=["rbf-each", "nested"]))
def test_the_variance_is_exact_and_of_the_precision_of_the_kernel(name, dtype):
    kernel = jax.tree.map(lambda leaf: leaf.astype(dtype), kernels()[name])

    @jax.jit
    def designed(keys, points):
        features = drawn(keys, kernel, 10, 2, "quasi-random")
        variance = kernels()[name](POINTS[0], POINTS[0])
        return features, jax.vmap(lambda one: one.design(points))(features), variance

    keys = jax.random.split(jax.random.key(0), 2)
    features, design, variance = designed(keys, np.asarray(POINTS, dtype))
    assert features.frequencies.dtype == features.amplitudes.dtype == design.dtype == dtype
    assert np.all(np.isfinite(features.frequencies))
    squares = np.sum(np.asarray(design) ** 2, axis=2)
    np.testing.assert_allclose(squares, variance, rtol=8.0 * float(jnp.finfo(dtype).eps))


@pytest.mark.parametrize("name", by_tier(sorted(set(KERNELS) - set(RATES)), normal=["nested"]))
@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_the_features_are_unbiased(name, sampling):
    kernel = kernels()[name]
    x, y = POINTS[0], POINTS[0] + jnp.asarray([0.3, -0.2])

    @jax.jit
    def products_of(keys):
        features = drawn(keys, kernel, 8, 2, sampling)
        products = jax.vmap(lambda one: jnp.sum(one(x) * one(y)))(features)
        return products, kernel(x, y), kernel(x, x)

    products, covariance, variance = products_of(jax.random.split(jax.random.key(1), 4000))
    standard_error = np.std(products) / np.sqrt(len(products))
    assert abs(np.mean(products) - covariance) < 4.0 * standard_error
    assert standard_error < 0.02 * variance


@pytest.mark.parametrize(
    "kernel, degrees",
    [(RBF, np.inf), (Matern12, 1), (Matern32, 3), (Matern52, 5)],
    ids=lambda value: str(value),
)
@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_frequencies_follow_a_student_t_of_twice_the_smoothness(kernel, degrees, sampling):
    lengthscale = np.asarray([0.3, 2.0])
    features = drawn(jax.random.split(jax.random.key(2), 1500), kernel(number(lengthscale)), 8, 2, sampling)
    first = np.asarray(features.frequencies)[:, 0] * lengthscale  # one of each set: independent
    for axis in range(2):
        assert stats.kstest(first[:, axis], stats.t(degrees).cdf).pvalue > 1e-3
    # The dimensions share their denominator: |w|^2 / D has Fisher's F distribution.
    squares = (first**2).mean(axis=1)
    expected = stats.f(2, degrees) if np.isfinite(degrees) else stats.chi2(2, scale=0.5)
    assert stats.kstest(squares, expected.cdf).pvalue > 1e-3


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_a_product_adds_frequencies_and_a_sum_shares_them_out(sampling):
    kernel = Scaled(RBF(number(1.0)), number(4.0)) + RBF(number(1e6))
    one = drawn(jax.random.key(3)[None], kernel, 14, 2, sampling)
    both = jax.tree.map(lambda leaf: np.asarray(leaf)[0], one)
    assert both.num_features == 14
    np.testing.assert_allclose(both.amplitudes**2, [4.0 / 4] * 4 + [1.0 / 3] * 3)
    assert np.all(np.abs(both.frequencies[4:]) < 1e-4) and np.all(
        np.abs(both.frequencies[:4]).max(axis=1) > 1e-3
    )
    # exp(-r^2/2) twice is one squared exponential whose lengthscale is shorter by sqrt(2).
    twice = drawn(
        jax.random.split(jax.random.key(4), 2000), RBF(number(1.0)) * RBF(number(1.0)), 2, 1, sampling
    )
    assert stats.kstest(np.asarray(twice.frequencies)[:, 0, 0] / np.sqrt(2.0), "norm").pvalue > 1e-3


@pytest.mark.parametrize("order, num_dims", [(0, 1), (5, 1), (3, 2), (2, 3)])
def test_the_fourier_basis_is_all_cosines_up_to_its_order(order, num_dims):
    features = FourierBasis(order, num_dims)
    xs = np.random.default_rng(0).uniform(size=(9, num_dims))
    design = features.design(jnp.asarray(xs))
    assert design.shape == (9, features.num_features) == (9, (order + 1) ** num_dims)
    columns = [np.cos(np.pi * xs @ np.asarray(c)) for c in np.ndindex(*[order + 1] * num_dims)]
    np.testing.assert_allclose(design, np.stack(columns, axis=1), atol=1e-14)
    np.testing.assert_array_equal(design[:, 0], 1.0)


@pytest.mark.parametrize("degree, num_dims", [(1, 1), (2, 3), (3, 2)])
@pytest.mark.parametrize("has_bias", [False, True])
def test_polynomials_are_those_of_scikit_learn(degree, num_dims, has_bias):
    features = Polynomial(degree, num_dims, has_bias)
    xs = np.random.default_rng(0).uniform(-2.0, 2.0, (9, num_dims))
    expected = PolynomialFeatures(degree, include_bias=has_bias).fit_transform(xs)
    design = jax.jit(lambda xs: features.design(xs))(xs)
    np.testing.assert_allclose(design, expected, rtol=1e-13)
    assert features.num_features == expected.shape[1]


def test_polynomials_have_finite_gradients_at_zero():
    gradient = np.asarray(jax.jit(jax.jacobian(Polynomial(3, 2)))(np.zeros(2)))
    np.testing.assert_array_equal(gradient[1:3], np.eye(2))
    assert not np.any(gradient[3:])


@pytest.mark.parametrize("width", [0.4, [0.4, 2.0]])
@pytest.mark.parametrize("has_bias", [False, True])
def test_radial_bumps_are_a_kernel_between_points_and_centres(width, has_bias):
    centres = np.random.default_rng(1).uniform(-1.0, 1.0, (7, 2))
    features = RadialBasis(jnp.asarray(centres), number(width), has_bias)
    design = np.asarray(features.design(POINTS))
    assert features.num_features == design.shape[1] == 7 + has_bias
    expected = rbf_kernel(np.asarray(POINTS) / width, centres / np.asarray(width), gamma=0.5)
    np.testing.assert_allclose(design[:, has_bias:], expected, rtol=1e-12)
    assert not has_bias or np.all(design[:, 0] == 1.0)


class Linear(Kernel):
    def __call__(self, x, y):
        return jnp.sum(x * y)


def test_features_that_cannot_be_are_refused():
    def draw(kernel, num_features, num_dims=2):
        return lambda: RandomFourier.draw(jax.random.key(0), kernel, num_features, num_dims)

    rbf = RBF(number(0.5))
    four = (rbf + RBF(number(2.0))) * (Matern12(number(1.0)) + Matern32(number(2.0)))
    odd = [(draw(rbf, num), f"num_features: got {num}; allowed: even, >= 2") for num in (-2, 0, 1, 7)]
    assert_refused(
        [
            *odd,
            (draw(four, 6), "num_features: got 6; allowed: even, >= 8"),
            (draw(rbf, 4, 0), "num_dims: got 0"),
            (draw(RBF(number([0.5, 1.0, 2.0])), 4), "lengthscale: got 3; allowed: 1 or 2"),
            (lambda: FourierBasis(-1, 2), "order: got -1"),
            (lambda: FourierBasis(3, 0), "num_dims: got 0"),
            (lambda: Polynomial(0, 2, has_bias=False), "degree: got 0; allowed: >= 1"),
            (lambda: Polynomial(-1, 2), "degree: got -1; allowed: >= 0"),
            (lambda: Polynomial(2, 0), "num_dims: got 0"),
            (lambda: Polynomial(2, 2).design([[1.0]]), r"xs: got shape \(1, 1\); allowed: \[points, 2\]"),
            (lambda: FourierBasis(3, 1).design([[1, 2]]), r"xs: got shape \(1, 2\); allowed: \[points, 1\]"),
            (lambda: RadialBasis(jnp.zeros((0, 2)), number(1.0)), "centres: got 0"),
        ]
    )
    unknown = "the spectral density of the kernel Linear is not known"
    assert_refused([(draw(rbf + Linear(), 4), unknown)], TypeError)
