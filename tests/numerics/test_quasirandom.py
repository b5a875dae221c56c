"""The shifted Kronecker sequence and the scrambled Halton sequence: even, and uniform point by point."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from bojax.numerics.quasirandom import generalised_golden_ratio, scrambled_halton, shifted_kronecker
from tests.tiers import by_tier


@functools.partial(jax.jit, static_argnums=(0, 2, 3, 4))
def drawn(sequence, keys, num_points, num_dims, dtype=jnp.float64):
    """One sequence for each key."""
    return jax.vmap(lambda key: sequence(key, num_points, num_dims, dtype))(keys)


points = functools.partial(drawn, shifted_kronecker)
halton = functools.partial(drawn, scrambled_halton)


@pytest.mark.parametrize("num_dims", [1, 2, 3, 4, 7])
def test_the_ratio_is_the_root_of_its_polynomial(num_dims):
    ratio = generalised_golden_ratio(num_dims)
    assert ratio > 1.0
    assert ratio ** (num_dims + 1) == pytest.approx(ratio + 1.0, rel=1e-14)


@pytest.mark.parametrize("num_points", [32, 128])
@pytest.mark.parametrize("num_dims", [1, 2, 3, 4])
def test_points_are_more_even_than_random_ones(num_points, num_dims):
    def discrepancy(xs):
        # The wrap-around discrepancy is invariant under shifts modulo the box, so one set is enough.
        return qmc.discrepancy(xs, method="WD")

    even = np.asarray(points(jax.random.split(jax.random.key(1), 2), num_points, num_dims))
    assert np.all(np.abs(even) <= 1.0)
    ours, shifted = (discrepancy(0.5 + 0.5 * xs) for xs in even)
    assert ours == pytest.approx(shifted, rel=1e-9)
    random = np.random.default_rng(0).uniform(size=(100, num_points, num_dims))
    assert ours < np.quantile([discrepancy(xs) for xs in random], 0.05)
    single = points(jax.random.split(jax.random.key(1), 2), num_points, num_dims, jnp.float32)
    assert single.dtype == jnp.float32 and np.all(np.abs(single) <= 1.0)


@pytest.mark.parametrize("index", [0, 1, 17, 63])
def test_each_point_is_uniform_over_the_keys(index):
    shifted = np.asarray(points(jax.random.split(jax.random.key(2), 2000), 64, 2))[:, index]
    scrambled = np.asarray(halton(jax.random.split(jax.random.key(3), 2000), 64, 3))[:, index]
    for xs in (0.5 + 0.5 * shifted, scrambled):
        for axis, column in enumerate(xs.T):
            assert stats.kstest(column, "uniform").pvalue > 1e-3
            assert abs(stats.spearmanr(column, xs[:, axis - 1]).statistic) < 0.08


quantiles = jax.jit(jax.scipy.special.ndtri)


@pytest.mark.parametrize("dtype", by_tier([jnp.float32, jnp.float64], normal=[jnp.float32]))
@pytest.mark.parametrize("num_points, num_dims", [(0, 2), (1, 1), (2, 3), (300, 15)])
def test_scrambled_points_have_finite_quantiles(num_points, num_dims, dtype):
    xs = halton(jax.random.split(jax.random.key(0), 20), num_points, num_dims, dtype)
    assert xs.shape == (20, num_points, num_dims)
    assert xs.dtype == dtype
    assert np.all(np.asarray(xs) > 0.0) and np.all(np.asarray(xs) < 1.0)
    assert np.all(np.isfinite(quantiles(xs)))


@pytest.mark.parametrize("num_dims", [1, 2, 5])
@pytest.mark.parametrize("places", [1, 2])
def test_scrambled_points_share_out_every_interval_of_their_base(num_dims, places):
    # The first b^k points have one in each of the b^k intervals of length b^-k, and so has every next b^k.
    base = [2, 3, 5, 7, 11][num_dims - 1]
    xs = np.asarray(halton(jax.random.split(jax.random.key(1), 3), 3 * base**places, num_dims))[..., -1]
    cells = np.floor(xs * base**places).reshape(3, 3, base**places)
    np.testing.assert_array_equal(np.sort(cells), np.broadcast_to(np.arange(base**places), cells.shape))


@pytest.mark.parametrize("num_points", [64, 256])
@pytest.mark.parametrize("num_dims", by_tier([1, 2, 4, 9, 15], normal=[1, 15]))
def test_scrambled_points_are_as_even_as_those_of_scipy(num_points, num_dims):
    ours = np.asarray(halton(jax.random.split(jax.random.key(2), 9), num_points, num_dims))
    theirs = [qmc.Halton(num_dims, rng=seed).random(num_points) for seed in range(9)]
    random = np.random.default_rng(0).uniform(size=(9, num_points, num_dims))
    halton_of_scipy, independent = (
        np.median([qmc.discrepancy(xs) for xs in sets]) for sets in (theirs, random)
    )
    found = np.median([qmc.discrepancy(xs) for xs in ours])
    assert found < 2.0 * halton_of_scipy
    assert found < 0.75 * independent


def test_large_bases_do_not_follow_each_other():
    # Unscrambled, the first points of bases 41 and 43 lie on a line: correlation 0.99.
    xs = np.asarray(halton(jax.random.split(jax.random.key(4), 20), 40, 14))
    correlations = [stats.spearmanr(points[:, 12], points[:, 13]).statistic for points in xs]
    assert abs(np.mean(correlations)) < 0.2
    plain = qmc.Halton(14, scramble=False).random(40)
    assert stats.spearmanr(plain[:, 12], plain[:, 13]).statistic > 0.9
