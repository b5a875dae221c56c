"""Standardised values have no unit and are always defined."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.acquisition.bayesian_optimisation import standardise

scaled = jax.jit(lambda *args: standardise(*args)[0])
RNG = np.random.default_rng(0)
EXISTS = jnp.arange(12) < 9


@pytest.mark.parametrize("scale", [1e-200, 1e-3, 1.0, 1e200])
@pytest.mark.parametrize("offset", [0.0, 1.0, -1e6])
def test_mean_and_variance_are_those_of_the_standard_normal(scale, offset):
    values = scale * (RNG.normal(size=12) + offset)
    found = np.asarray(scaled(jnp.asarray(values), EXISTS))
    np.testing.assert_allclose(found[:9].mean(), 0.0, atol=1e-8)
    np.testing.assert_allclose(found[:9].std(), 1.0, rtol=1e-12)
    relative = values / scale
    np.testing.assert_allclose(
        found[:9], (relative[:9] - relative[:9].mean()) / relative[:9].std(), atol=1e-8
    )


@pytest.mark.parametrize("rest", [0.0, 5.0, np.nan, np.inf])
def test_what_does_not_exist_has_no_part(rest):
    values = jnp.asarray(RNG.normal(size=12))
    alone = scaled(values[:9], EXISTS[:9])
    found = scaled(jnp.where(EXISTS, values, rest), EXISTS)
    np.testing.assert_allclose(found[:9], alone, atol=1e-14)
    np.testing.assert_array_equal(found[9:], 0.0)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("value", [0.0, 0.1, -1e6, 1e30])
def test_equal_values_are_zero(dtype, value):
    np.testing.assert_array_equal(scaled(jnp.full(12, value, dtype), EXISTS), jnp.zeros(12, dtype))


def test_no_value_is_zero():
    np.testing.assert_array_equal(scaled(jnp.ones(3), jnp.zeros(3, bool)), jnp.zeros(3))


def test_a_small_difference_between_large_values_counts():
    found = scaled(jnp.asarray([1e6, 1e6 + 1e-3]), jnp.ones(2, bool))
    np.testing.assert_allclose(found, [-1.0, 1.0], rtol=1e-6)
