"""Lookahead equals a refit of the Gaussian process with all imagined observations."""

import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Matern12, Matern32, Matern52, Scaled
from bojax.models.lookahead import LookaheadRoot, look_ahead
from bojax.models.means import ConstantMean, LinearMean, ZeroMean
from bojax.numerics.linalg import noise_floor
from tests.arrays import f64
from tests.reference.bridge import reference_kernel, reference_mean
from tests.reference.gaussian_process import GP
from tests.tiers import by_tier

NUM_STAGES, SIZE = 3, 4


KERNELS = {
    "rbf": RBF(f64(0.5)),
    "rbf, a lengthscale a dimension": RBF(f64([0.3, 0.9])),
    "matern 1/2": Matern12(f64(0.7)),
    "matern 3/2": Matern32(f64(0.7)),
    "matern 5/2": Matern52(f64([0.5, 0.8])),
    "scaled": Scaled(RBF(f64(0.5)), f64(4.0)),
    "a sum": Scaled(Matern32(f64(0.4)), f64(0.5)) + RBF(f64(1.2)),
    "a product": Scaled(Matern52(f64(0.8)), f64(2.0)) * RBF(f64(1.5)),
}
each_kernel = pytest.mark.parametrize(
    "name", by_tier(KERNELS, normal=["matern 1/2", "matern 5/2", "a sum", "a product"])
)
MEANS = {
    "zero": ZeroMean(),
    "constant": ConstantMean(f64(1.3)),
    "linear": LinearMean(f64([0.7, -0.4]), f64(0.2)),
}


@jax.jit
def fit(kernel, mean, noise_variance, x, y, count):
    return GaussianProcess.fit(kernel, noise_variance, x, y, mean=mean, count=count)


@jax.jit
def ahead(posterior, points, is_observed, innovations):
    root = LookaheadRoot.of(posterior)
    return look_ahead(root, points, is_observed, innovations, NUM_STAGES, with_gradient=True)


def refitted(posterior, points, is_observed, innovations):
    """Mean, variance and gradient at every observed point under the belief before its stage."""
    kernel, mean = reference_kernel(posterior.kernel), reference_mean(posterior.mean)
    prior_variance = kernel(np.zeros((1, 2)), np.zeros((1, 2)))[0, 0]
    noise = max(float(posterior.noise_variance), noise_floor(posterior.y.dtype) * prior_variance)
    count = int(posterior.count)
    x, y = np.asarray(posterior.x)[:count], np.asarray(posterior.y)[:count]
    found = []
    for stage in range(NUM_STAGES):
        rows = np.arange(stage * SIZE, (stage + 1) * SIZE)
        rows = rows[np.asarray(is_observed)[rows]]
        gp, at = GP(kernel, mean, noise, x, y), np.asarray(points)[rows]
        m, covariance = gp.predict(at)
        found += zip(m, np.diag(covariance), gp.gradient(at), strict=True)
        draw = np.linalg.cholesky(covariance + noise * np.eye(len(rows))) @ np.asarray(innovations)[rows]
        x, y = np.concatenate([x, at]), np.concatenate([y, m + draw])
    return [np.array(part) for part in zip(*found, strict=True)]


def case(kernel, mean=MEANS["zero"], noise_variance=0.01, count=12, capacity=20, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (capacity, 2))
    y = np.sin(3.0 * x[:, 0]) + x[:, 1] + 0.1 * rng.normal(size=capacity)
    points = rng.uniform(-1.0, 1.0, (NUM_STAGES * SIZE, 2))
    innovations = rng.normal(size=NUM_STAGES * SIZE)
    count = jnp.asarray(count, jnp.int32)
    posterior = fit(kernel, mean, f64(noise_variance), f64(x), f64(y), count)
    return posterior, f64(points), jnp.ones(NUM_STAGES * SIZE, bool), f64(innovations)


def assert_refitted(posterior, points, is_observed, innovations, atol=1e-9):
    found, expected = (
        ahead(posterior, points, is_observed, innovations),
        refitted(posterior, points, is_observed, innovations),
    )
    for got, wanted in zip((found.mean, found.variance, found.gradient), expected, strict=True):
        np.testing.assert_allclose(np.asarray(got)[np.asarray(is_observed)], wanted, rtol=0.0, atol=atol)


@each_kernel
def test_of_every_kernel_it_is_a_refit(name):
    kernel = KERNELS[name]
    for count in (0, 1, 12, 20):
        assert_refitted(*case(kernel, count=count))


@pytest.mark.parametrize("mean", MEANS.values(), ids=MEANS)
@pytest.mark.parametrize("noise_variance", [1e-4, 1.0])
def test_of_every_mean_and_noise_it_is_a_refit(mean, noise_variance):
    for count in (0, 20):
        assert_refitted(*case(KERNELS["a sum"], mean, noise_variance, count))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_not_observed_leaves_no_trace(seed):
    posterior, points, _, innovations = case(KERNELS["rbf"], MEANS["linear"], seed=seed)
    is_observed = np.random.default_rng(seed).uniform(size=len(points)) < 0.6
    is_observed[SIZE : 2 * SIZE] &= seed != 1  # a stage without observations
    assert_refitted(posterior, points, jnp.asarray(is_observed), innovations)
    # Nor does it matter where it is.
    elsewhere = jnp.where(jnp.asarray(is_observed)[:, None], points, 0.0)
    one, other = (ahead(posterior, at, jnp.asarray(is_observed), innovations) for at in (points, elsewhere))
    for got, wanted in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(np.asarray(got)[is_observed], np.asarray(wanted)[is_observed], atol=1e-12)


@pytest.mark.parametrize("lengthscale", [0.5, 30.0, 1e6, 1e-6])
@pytest.mark.parametrize("kernel", [RBF, Matern12, Matern32])
def test_without_noise_the_same_point_again_and_again_is_finite(kernel, lengthscale):
    rng = np.random.default_rng(0)
    places = rng.uniform(-1.0, 1.0, (4, 2))
    x = f64(places[rng.integers(4, size=20)])
    zero = ZeroMean()
    posterior = fit(kernel(f64(lengthscale)), zero, f64(0.0), x, x[:, 0], jnp.asarray(20, jnp.int32))
    # Each stage looks at a known place twice, and at a new place that the other stages see too.
    points = f64(np.tile([places[0], places[0], places[1], [0.3, 0.4]], (NUM_STAGES, 1)))
    is_observed, innovations = jnp.ones(len(points), bool), f64(rng.normal(size=len(points)))
    found = ahead(posterior, points, is_observed, innovations)
    for part in (found.mean, found.variance, found.gradient):
        assert np.all(np.isfinite(part))
    jitter = 1.1 * noise_floor(jnp.float64)
    assert np.all(found.variance >= 0.0) and np.all(found.variance <= 1.0 + 1e-9)
    np.testing.assert_allclose(found.variance.reshape(NUM_STAGES, SIZE)[:, :3], 0.0, atol=jitter)
    np.testing.assert_allclose(found.variance.reshape(NUM_STAGES, SIZE)[1:, 3], 0.0, atol=jitter)
    if lengthscale < 1.0:
        expected = np.tile(places[[0, 0, 1], 0], (NUM_STAGES, 1))
        np.testing.assert_allclose(found.mean.reshape(NUM_STAGES, SIZE)[:, :3], expected, atol=1e-4)
        # The next stage expects the imagined observation at its point.
        second, third = found.mean.reshape(NUM_STAGES, SIZE)[1:, 3]
        np.testing.assert_allclose(second, third, atol=1e-4)


def test_in_single_precision_the_error_is_that_of_rounding():
    # As many observations as at the end of an episode: 192 in a square of six lengthscales.
    rng = np.random.default_rng(0)
    x, kernel = rng.uniform(0.0, 6.0, (200, 2)), Scaled(RBF(f64(1.0)), f64(1.0))
    y = np.sin(x[:, 0]) * np.cos(x[:, 1]) + 0.1 * rng.normal(size=200)
    points, innovations = rng.uniform(2.0, 4.0, (NUM_STAGES * SIZE, 2)), rng.normal(size=NUM_STAGES * SIZE)
    found = []
    for dtype in (jnp.float64, jnp.float32):
        own, noise, *numbers = jax.tree.map(
            lambda leaf, dtype=dtype: jnp.asarray(leaf, dtype), (kernel, 0.01, x, y, points, innovations)
        )
        posterior = fit(own, ZeroMean(), noise, *numbers[:2], jnp.asarray(192, jnp.int32))
        found.append(ahead(posterior, numbers[2], jnp.ones(len(points), bool), numbers[3]))
    for name, bound in (("mean", 1e-4), ("variance", 1e-5), ("gradient", 1e-3)):
        double, single = (np.asarray(getattr(each, name)) for each in found)
        assert single.dtype == np.float32 and np.abs(single - double).max() < bound


def test_nothing_is_refitted():
    # No LAPACK call: imagined observations are eliminated by elementwise arithmetic.
    arguments = case(KERNELS["rbf"])

    def solved(jaxpr):
        for equation in jaxpr.eqns:
            if equation.primitive.name in ("cholesky", "triangular_solve", "lu", "eigh"):
                yield from (variable.aval.shape for variable in equation.invars)
            for inner in jax.extend.core.jaxprs_in_params(equation.params):
                yield from solved(inner)

    root = LookaheadRoot.of(arguments[0])
    program = jax.make_jaxpr(lambda root, *rest: look_ahead(root, *rest, NUM_STAGES, True))
    assert not list(solved(program(root, *arguments[1:]).jaxpr))
    refitted = jax.make_jaxpr(
        lambda gp: GaussianProcess.fit(gp.kernel, gp.noise_variance, gp.x, gp.y).inverse_cholesky
    )
    assert list(solved(refitted(arguments[0]).jaxpr)), "the test would not see a factorisation"
