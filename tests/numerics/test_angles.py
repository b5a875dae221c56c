"""Wrapped angles point in the same direction and lie in their interval; cosines and sines are exact."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.angles import cos_and_sin, wrap_to_2pi, wrap_to_pi

ANGLES = np.concatenate([np.linspace(-20.0, 20.0, 401), np.pi * np.arange(-4.0, 5.0)])


@pytest.mark.parametrize(("wrap", "low"), [(wrap_to_pi, -np.pi), (wrap_to_2pi, 0.0)])
def test_a_wrapped_angle_is_equivalent_and_within_its_interval(wrap, low):
    wrapped = np.asarray(wrap(jnp.asarray(ANGLES)))
    assert np.all((wrapped >= low) & (wrapped < low + 2.0 * np.pi))
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * ANGLES), atol=1e-13)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("wrap", "low"), [(wrap_to_pi, -np.pi), (wrap_to_2pi, 0.0)])
def test_an_angle_just_below_an_interval_is_wrapped_into_it(wrap, low, dtype):
    tiny = np.array([-1e-20, -1e-9, 0.0, np.nan], dtype)
    wrapped = np.asarray(wrap(jnp.asarray(low + tiny, dtype)))
    assert wrapped.dtype == dtype
    high = dtype(low + 2.0 * np.pi)
    assert np.all((wrapped[:3] >= dtype(low)) & (wrapped[:3] < high))
    assert np.isnan(wrapped[3])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_cosines_and_sines_are_exact_within_rounding_of_their_values_and_angles(dtype):
    rng = np.random.default_rng(0)
    sizes = 10.0 ** rng.uniform(-3.0, 9.0, 4000)
    angles = np.concatenate([ANGLES, [0.0, -0.0], rng.choice([-1.0, 1.0], 4000) * sizes]).astype(dtype)
    cosines, sines = (np.asarray(part) for part in jax.jit(cos_and_sin)(jnp.asarray(angles)))
    assert cosines.dtype == sines.dtype == dtype
    exact, eps = angles.astype(np.longdouble), np.finfo(dtype).eps
    error = np.maximum(np.abs(cosines - np.cos(exact)), np.abs(sines - np.sin(exact)))
    assert np.all(error <= eps * (1.0 + 0.5 * np.abs(angles)))
    ordinary = np.abs(angles) < 1e3
    assert np.all(error[ordinary] <= eps)


def test_an_angle_that_is_not_finite_has_no_cosine_and_a_huge_one_has_a_bounded_one():
    cosines, sines = cos_and_sin(jnp.asarray([np.nan, np.inf, -np.inf, 1e30]))
    np.testing.assert_array_equal(np.isnan(cosines), [True, True, True, False])
    assert abs(cosines[3]) <= 1.0 and abs(sines[3]) <= 1.0


def test_the_derivatives_of_cosine_and_sine_are_each_other():
    angles = jnp.asarray(ANGLES)
    (cosines, sines), (of_cosines, of_sines) = jax.jvp(cos_and_sin, (angles,), (jnp.ones_like(angles),))
    np.testing.assert_allclose(of_cosines, -sines, atol=1e-13)
    np.testing.assert_allclose(of_sines, cosines, atol=1e-13)
