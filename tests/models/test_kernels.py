"""Kernels, sums and products against scikit-learn, and their gradients at coinciding points."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process import kernels as sk

from bojax.models.evidence import relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Matern12, Matern32, Matern52, Scaled, Warped, as_kernel
from tests.refusals import assert_refused
from tests.tiers import by_tier

REFERENCES = {
    RBF: sk.RBF,
    Matern12: lambda lengthscale: sk.Matern(lengthscale, nu=0.5),
    Matern32: lambda lengthscale: sk.Matern(lengthscale, nu=1.5),
    Matern52: lambda lengthscale: sk.Matern(lengthscale, nu=2.5),
}
LENGTHSCALES = [0.05, 0.5, 3.0, [0.2, 1.0, 40.0]]
each_kernel = pytest.mark.parametrize("kernel", REFERENCES)
gram = jax.jit(lambda kernel, xs, ys: kernel.gram(xs, ys))


def points(seed: int, num: int):
    return jnp.asarray(np.random.default_rng(seed).uniform(-1.0, 1.0, (num, 3)))


@each_kernel
def test_equals_the_kernel_of_scikit_learn(kernel):
    xs, ys = points(0, 20), points(1, 30)
    for lengthscale in LENGTHSCALES:
        expected = REFERENCES[kernel](lengthscale)(np.asarray(xs), np.asarray(ys))
        covariances = gram(kernel(jnp.asarray(lengthscale)), xs, ys)
        np.testing.assert_allclose(covariances, expected, rtol=1e-12, atol=1e-300)


@each_kernel
def test_is_a_correlation(kernel):
    xs = points(2, 15)
    correlations = np.asarray(gram(kernel(jnp.asarray(0.7)), xs, xs))
    np.testing.assert_array_equal(np.diag(correlations), 1.0)
    np.testing.assert_array_equal(correlations, correlations.T)
    assert np.all(correlations > 0.0) and np.all(correlations <= 1.0)
    assert np.linalg.eigvalsh(correlations).min() > 0.0


@each_kernel
def test_an_endless_lengthscale_ignores_its_dimension(kernel):
    xs, ys = points(0, 5), points(1, 5)
    ignoring = kernel(jnp.asarray([0.4, jnp.inf, 0.4]))
    np.testing.assert_array_equal(gram(ignoring, xs, ys), gram(ignoring, xs, ys.at[:, 1].add(5.0)))


@each_kernel
def test_gradients_are_finite_where_points_coincide(kernel):
    # Compared with points 1e-7 apart, for all but the exponential kernel, which has a kink there.
    x = points(4, 1)[0]
    gradients = jax.jit(jax.grad(lambda k, a, b: k(a, b), argnums=(0, 1, 2)))
    at = gradients(kernel(jnp.asarray(0.5)), x, x)
    for leaf in jax.tree.leaves(at):
        np.testing.assert_array_equal(leaf, jnp.zeros_like(leaf))
    if kernel is not Matern12:
        for leaf in jax.tree.leaves(gradients(kernel(jnp.asarray(0.5)), x, x + 1e-7)):
            assert np.all(np.abs(leaf) < 1e-5) and np.all(np.abs(leaf) > 0.0)


@pytest.mark.parametrize("kernel", by_tier(REFERENCES, normal=[RBF, Matern12]))
def test_sums_products_and_scaling_are_those_of_scikit_learn(kernel):
    xs, ys = points(0, 20), points(1, 30)
    ours = Scaled(kernel(jnp.asarray([0.2, 1.0, 4.0])), jnp.asarray(2.5))
    theirs = sk.ConstantKernel(2.5) * REFERENCES[kernel]([0.2, 1.0, 4.0])
    other, their_other = Matern32(jnp.asarray(0.7)), sk.Matern(0.7, nu=1.5)
    for made, reference in [
        (ours, theirs),
        (ours + other, theirs + their_other),
        (ours * other, theirs * their_other),
        ((ours + other) * other, (theirs + their_other) * their_other),
    ]:
        expected = reference(np.asarray(xs), np.asarray(ys))
        np.testing.assert_allclose(gram(made, xs, ys), expected, rtol=1e-12, atol=1e-300)
        diagonal = np.asarray([made(x, x) for x in xs[:3]])
        np.testing.assert_allclose(diagonal, reference.diag(np.asarray(xs))[:3], rtol=1e-15)


@each_kernel
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_points_that_are_endlessly_far_apart_are_independent(kernel, dtype):
    # Squares of their distances overflow.
    xs = jnp.asarray([[0.0] * 3, [1e30] * 3, [-3e38] * 3, [1.0, 0.0, 3e38]], dtype)
    covariances = gram(kernel(jnp.asarray(1e-3, dtype)), xs, xs)
    np.testing.assert_array_equal(covariances, np.eye(4))


@each_kernel
def test_numbers_and_lists_become_arrays(kernel):
    for given, shape in ((2, ()), (0.5, ()), ([1, 2], (2,)), (np.ones(3), (3,)), (jnp.asarray(1), ())):
        lengthscale = kernel(given).lengthscale
        assert lengthscale.shape == shape and lengthscale.dtype == jnp.float64 and not lengthscale.weak_type
    assert kernel(np.float32(2.0)).lengthscale.dtype == jnp.float32
    wrong, line = ("a", None, 1j, True, [[1.0], [2.0, 3.0]]), jnp.zeros((4, 1))
    assert_refused((lambda w=w: kernel(w), "lengthscale: got .*; allowed: numbers") for w in wrong)
    # One coordinate and two lengthscales would be broadcast in silence.
    each = "lengthscale: got 2 numbers; allowed: 1, or one for each dimension: 1"
    assert_refused([(lambda: kernel([0.5, 1.0]).gram(line, line), each)])


BOX = {"low": [-1.0, 0.0], "high": [1.0, 4.0]}


def warped_by_numpy(points, a, b):
    """Kumaraswamy's distribution function within the box, and the identity outside of it."""
    low, high = np.asarray(BOX["low"]), np.asarray(BOX["high"])
    share = (points - low) / (high - low)
    inside = np.clip(share, 0.0, 1.0)
    return low + (high - low) * np.where(inside == share, 1.0 - (1.0 - inside**a) ** b, share)


def test_a_warped_kernel_is_the_kernel_of_warped_inputs():
    xs = np.random.default_rng(0).uniform([-1.2, -0.5], [1.2, 4.5], (40, 2))
    # Exponents of one leave the inputs as they are.
    for a, b, warped in (
        ([0.5, 2.0], [3.0, 0.8], warped_by_numpy(xs, np.asarray([0.5, 2.0]), np.asarray([3.0, 0.8]))),
        ([1.0, 1.0], [1.0, 1.0], xs),
    ):
        found = gram(Warped(Matern32(0.7), a, b, **BOX), jnp.asarray(xs), jnp.asarray(xs))
        np.testing.assert_allclose(found, sk.Matern(0.7, nu=1.5)(warped), rtol=1e-9)


def test_gradients_of_a_warped_kernel_are_finite_at_the_border():
    corner = jnp.asarray([-1.0, 0.0])
    kernel = Warped(RBF(0.5), 0.5, [2.0, 0.5], **BOX)
    slopes = jax.jit(jax.grad(lambda kernel, x, y: kernel(x, y), argnums=(0, 1)))
    gradients = slopes(kernel, corner, corner + 0.1)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients))


def test_learned_exponents_fit_a_function_that_varies_faster_at_one_end():
    x = np.sort(np.random.default_rng(2).uniform(0.0, 1.0, (40, 1)), axis=0)
    y = np.sin(12.0 * x[:, 0] ** 3)  # slow near 0, fast near 1
    fit, learn = eqx.filter_jit(GaussianProcess.fit), eqx.filter_jit(relearn)
    evidences = {}
    for name, kernel in {
        "stationary": Scaled(RBF(0.2), 1.0),
        "warped": Scaled(Warped(RBF(0.2), 1.0, 1.0, low=0.0, high=1.0), 1.0),
    }.items():
        learned, _ = learn(fit(kernel, 1e-4, x, y, capacity=40), jax.random.key(0))
        evidences[name] = float(learned.log_marginal_likelihood())
    assert evidences["warped"] > evidences["stationary"] + 10.0
    assert float(learned.kernel.kernel.a) > 1.5


def test_a_warped_kernel_can_be_named_and_stretched():
    kernel = as_kernel({"kind": "warped", "kernel": "rbf", "a": [1.0, 2.0], **BOX})
    x, y = jnp.asarray([0.2, 1.0]), jnp.asarray([-0.5, 3.0])
    np.testing.assert_allclose(kernel.stretched(jnp.asarray(2.0))(2.0 * x, 2.0 * y), kernel(x, y), rtol=1e-12)


@pytest.mark.parametrize(("low", "high"), [([0.0], [1.0, 1.0]), ([0.0, 1.0], [1.0, 1.0])])
def test_a_box_without_volume_is_refused(low, high):
    with pytest.raises(ValueError, match="low, high: got .*; allowed: corners of a box"):
        Warped(RBF(0.5), 1.0, 1.0, low=low, high=high)
