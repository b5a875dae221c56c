"""Wrapped angles point in the same direction and lie in their interval."""

import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.angles import wrap_to_2pi, wrap_to_pi

ANGLES = np.concatenate([np.linspace(-20.0, 20.0, 401), np.pi * np.arange(-4.0, 5.0)])


@pytest.mark.parametrize(("wrap", "low"), [(wrap_to_pi, -np.pi), (wrap_to_2pi, 0.0)])
def test_a_wrapped_angle_is_equivalent_and_within_its_interval(wrap, low):
    wrapped = np.asarray(wrap(jnp.asarray(ANGLES)))
    assert np.all((wrapped >= low) & (wrapped < low + 2.0 * np.pi))
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * ANGLES), atol=1e-13)
